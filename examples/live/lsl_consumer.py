"""The person in a slot of a live system over the Lab Streaming Layer: needs pylsl only. NAME: "fgpose 0" """

import sys

import pylsl

(info,) = pylsl.resolve_byprop("name", sys.argv[1] if len(sys.argv) > 1 else "fgpose 0", timeout=20.0)
inlet = pylsl.StreamInlet(info)
labels = inlet.info().get_channel_labels()
while True:
    values, stamp_s = inlet.pull_sample()
    print(f"{pylsl.local_clock() - stamp_s:.3f} s ago", dict(zip(labels or (), values or (), strict=True)), flush=True)
