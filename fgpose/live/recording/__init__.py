"""A live session as a file, and back; videos in place of cameras."""
