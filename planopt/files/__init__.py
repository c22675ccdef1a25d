"""File access: size-limited reading of input files and atomic writing of results."""
