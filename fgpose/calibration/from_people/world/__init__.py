"""From that gauge to the world: scale, vertical and floor, from the body of the walker."""
