"""Where cameras went while a recording lasts."""
