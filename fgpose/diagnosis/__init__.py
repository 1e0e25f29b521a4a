"""What is probably wrong with a recording, its rig and its result; why; and what to do about it."""
