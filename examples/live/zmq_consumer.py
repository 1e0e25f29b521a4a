"""People from a live system over ZeroMQ: needs pyzmq, msgpack and numpy only. ADDRESS: tcp://127.0.0.1:5556"""

import sys

import msgpack
import numpy as np
import zmq


def as_array(value: dict) -> dict | np.ndarray:
    return np.frombuffer(value["data"], value["dtype"]).reshape(value["shape"]) if "dtype" in value else value


subscriber = zmq.Context.instance().socket(zmq.SUB)
subscriber.setsockopt(zmq.CONFLATE, 1)  # the newest only; it must be said before connecting
subscriber.subscribe(b"")
subscriber.connect(sys.argv[1] if len(sys.argv) > 1 else "tcp://127.0.0.1:5556")
while True:
    frame = msgpack.unpackb(subscriber.recv(), object_hook=as_array)
    print(frame["sequence"], f"{len(frame['people'])} people, {frame['observed_share']:.0%} observed", flush=True)
    for person in frame["people"]:
        print(person["person"], person["state"], frame["joints"][0], person["positions_m"][0], flush=True)
