"""The occlusion benchmark: the estimator and its competitors side by side, on motion whose truth is known."""
