"""What the body itself says of units, axes and skeletons."""
