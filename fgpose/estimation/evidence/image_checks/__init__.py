"""Images whose detections are not of the person at their moment."""
