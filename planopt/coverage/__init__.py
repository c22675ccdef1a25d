"""Networks that cover a region, answer events in it, and count themselves.

The modules need no problem file: they take arrays and frozen data and return the same.
"""
