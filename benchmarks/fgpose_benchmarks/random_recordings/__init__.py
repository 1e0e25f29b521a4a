"""Recordings whose rig, motion and errors are drawn at random, by no error model of the other benchmarks."""
