"""People and the links of a robot: distances that may be said without a fault."""
