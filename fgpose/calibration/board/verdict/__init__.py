"""How good a calibration with a board is: standard deviations, lenses that were given, and the verdict in words."""
