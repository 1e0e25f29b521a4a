"""Threads and processes that have owners: cameras and networks in one of their own."""
