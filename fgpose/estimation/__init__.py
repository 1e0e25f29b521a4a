"""One person, from observations to a trajectory."""
