"""What the errors of detections and cameras do to the joints: how large they are, how long they last."""
