"""Recordings whose rig, motion and errors are drawn at random: what no default was chosen on."""
