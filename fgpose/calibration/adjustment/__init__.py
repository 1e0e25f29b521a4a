"""The bundle adjustment: cameras, clocks, lenses, biases of the detections and joints, from what the cameras saw."""
