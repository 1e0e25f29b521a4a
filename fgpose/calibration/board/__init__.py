"""Calibrating cameras with a board: lenses and poses, from a chessboard, ChArUco board or grid of circles."""
