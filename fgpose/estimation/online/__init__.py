"""What the online estimator keeps from frame to frame: its window, and what it learns."""
