"""Solvers of the factor graph: GTSAM or numpy in batch, iSAM2 over a sliding window online."""
