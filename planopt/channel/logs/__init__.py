"""Power logs: tables of programs and files, their columns, and measurements."""
