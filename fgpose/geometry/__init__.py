"""Cameras, and points from several of them."""
