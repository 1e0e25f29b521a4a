"""A detector elsewhere sends keypoints of a camera to a live system: needs pyzmq, msgpack and numpy only.

python examples/live/keypoint_detector.py CAMERA WIDTH HEIGHT [ADDRESS]
"""

import sys
import time

import msgpack
import numpy as np
import zmq


def as_map(array: np.ndarray) -> dict:
    return {"shape": array.shape, "dtype": "<f4", "data": array.astype("<f4").tobytes()}


camera, width, height = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
live = zmq.Context.instance().socket(zmq.PUSH)
live.setsockopt(zmq.SNDHWM, 2)  # what cannot be sent soon is too old
live.connect(sys.argv[4] if len(sys.argv) > 4 else "tcp://127.0.0.1:5557")
while True:
    time_s = time.time()  # when the image was taken, by the clock of the camera
    points2d_px = np.random.default_rng().uniform(0, height, (2, 17, 2))  # your detector: (people, joints, 2)
    message = {"format": "fgpose/keypoints", "version": 1, "camera": camera, "time_s": time_s}
    message |= {"size_px": [width, height], "skeleton": "coco_17", "points2d_px": as_map(points2d_px)}
    live.send(msgpack.packb(message | {"confidence": as_map(np.full((2, 17), 0.9))}))
    time.sleep(1 / 30)
