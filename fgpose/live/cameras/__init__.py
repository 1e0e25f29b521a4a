"""From a source to its newest image, and what is wrong with a camera."""
