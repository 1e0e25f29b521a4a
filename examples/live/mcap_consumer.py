"""People from an MCAP file, without ROS: needs mcap-ros2-support only. FILE: people.mcap"""

import sys

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, decoder_factories=[DecoderFactory()])
    for _, _, _, people in reader.iter_decoded_messages(topics=["/people"]):
        for person in people.people:
            hip = person.positions[0]
            print(people.sequence, person.person, person.state, people.joints[0], hip.x, hip.y, hip.z)
