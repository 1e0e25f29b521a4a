"""What changes in time of the cameras, as calibration/changes finds it, in words."""
