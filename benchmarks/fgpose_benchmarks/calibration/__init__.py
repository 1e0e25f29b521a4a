"""The benchmark of calibration from people: rigs found from walkers, beside the true ones."""
