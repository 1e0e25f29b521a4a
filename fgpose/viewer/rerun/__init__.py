"""Recordings in Rerun; imported only when one is opened."""
