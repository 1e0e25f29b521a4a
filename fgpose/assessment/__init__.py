"""How good a recording or a result is."""
