"""Whole bodies: hands and face, each estimated where it hangs on the body."""
