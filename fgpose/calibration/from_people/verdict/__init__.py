"""How good the calibration is: standard deviations, checks by what did not make it, and the verdict in words."""
