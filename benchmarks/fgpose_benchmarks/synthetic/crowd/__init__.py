"""Several people who walk, sit and hide each other."""
