"""When the videos began: one walker on one clock, from the motion that all cameras see."""
