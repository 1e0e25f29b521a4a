"""When cameras began that were started by hand, from the motion of a board."""
