"""``fgpose benchmark``."""
