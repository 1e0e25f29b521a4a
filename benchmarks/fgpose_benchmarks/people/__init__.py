"""The benchmark of several people: who is who, and the pose of each, beside what others published."""
