"""Where the cameras are and how late, from the recording itself."""
