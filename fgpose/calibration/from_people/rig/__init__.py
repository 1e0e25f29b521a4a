"""The rig in a gauge of its own: a first one from pairs of cameras, and the adjusted one."""
