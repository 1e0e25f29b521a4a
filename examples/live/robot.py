"""A robot says where its links are and hears how far people are: needs pyzmq, msgpack and numpy only.

python examples/live/robot.py [POSES_ADDRESS DISTANCES_ADDRESS]
"""

import sys

import msgpack
import numpy as np
import zmq

addresses = sys.argv[1:] or ["tcp://127.0.0.1:5559", "tcp://127.0.0.1:5558"]
poses, distances = zmq.Context.instance().socket(zmq.PUSH), zmq.Context.instance().socket(zmq.SUB)
poses.connect(addresses[0])
distances.setsockopt(zmq.CONFLATE, 1)  # the newest only; it must be said before connecting
distances.subscribe(b"")
distances.connect(addresses[1])
pose = np.eye(4)  # of the link in the world, metres: your robot says where it is now
message = {"format": "fgpose/robot", "version": 1, "world_T_link": {"forearm": pose.tolist()}}
poses.send(msgpack.packb(message | {"reset": True}))  # faults are latched: there is one until the first reset
while distances.poll(200):
    for link in msgpack.unpackb(distances.recv())["links"]:
        print(link["link"], link["distance_m"], link["fault"] and link["fault"]["reason"], flush=True)
    poses.send(msgpack.packb(message))
print("no distances: this is a fault too", flush=True)
