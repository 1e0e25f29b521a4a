"""What the observations of a frame tell before anything is solved: gathered once, for every solver."""
