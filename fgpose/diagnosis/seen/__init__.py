"""Who is seen, when, and how surely."""
