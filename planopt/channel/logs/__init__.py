"""Power logs: file formats of known programs, column detection, and measurements."""
