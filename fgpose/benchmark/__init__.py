"""The occlusion benchmark: the estimator and other methods on the same recordings, whose truth is known."""
