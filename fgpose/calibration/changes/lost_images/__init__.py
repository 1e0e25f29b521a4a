"""Images that were lost again and again, in any number of cameras, whose frames were numbered on."""
