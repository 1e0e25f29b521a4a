"""The open benchmark: the estimator and other methods on real motion with simulated detections."""
