"""Causes that may explain why cameras disagree, each tried on the recording before it is named."""
