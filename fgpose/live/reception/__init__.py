"""Keypoints of detectors elsewhere: whose messages are taken, and which."""
