"""Poses and time offsets of the cameras, from the recording itself."""
