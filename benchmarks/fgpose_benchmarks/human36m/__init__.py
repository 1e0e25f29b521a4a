"""Benchmarks on data that the user brings: Human3.6M, images with pasted occluders, a robot cell."""
