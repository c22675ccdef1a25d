"""Files as such: bounded reading of input files, whole writing of results."""
