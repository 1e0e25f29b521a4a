"""One command a file. Their docstrings are what --help prints."""
