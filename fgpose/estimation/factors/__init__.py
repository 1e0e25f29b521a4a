"""The factors, one kind per file: residual, noise, and the variables that it joins."""
