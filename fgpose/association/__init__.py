"""Who is who: which detections of several people, in all views and frames, belong to one person."""
