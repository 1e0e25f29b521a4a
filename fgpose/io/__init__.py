"""Files in and out: calibrations, keypoints, skeletons, trajectories."""
