"""What a diagnosis of the last minute finds, while the system runs."""
