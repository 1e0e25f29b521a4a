"""Cameras calibrated from nothing but people who walk through the scene: poses, scale, vertical, starts and lenses."""
