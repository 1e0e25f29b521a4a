"""From detections to people, frame by frame."""
