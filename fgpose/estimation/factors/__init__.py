"""What is known of a person, one kind of factor a file: residual, noise, and the variables that it joins."""
