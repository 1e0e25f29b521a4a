"""A running system: cameras in, poses out."""
