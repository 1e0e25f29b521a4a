"""Recordings of the live system."""
