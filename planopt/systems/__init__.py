"""Systems: tasks beside motion planning, each a package with its tables, answers and checks."""
