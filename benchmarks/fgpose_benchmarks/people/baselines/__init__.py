"""What others published for several people, written again from the papers, on the same detections."""
