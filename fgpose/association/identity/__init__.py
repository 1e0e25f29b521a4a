"""Who somebody is: by their bones, their looks and the place; who comes back, and who may have been exchanged."""
