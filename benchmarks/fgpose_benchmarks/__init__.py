"""Scenes whose truth is known, and benchmarks of accuracy, speed and endurance. It gives ``fgpose benchmark``."""
