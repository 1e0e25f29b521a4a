"""Which detections are of their joint, and how far away is what one camera alone sees."""
