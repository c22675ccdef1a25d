"""Multi-agent networks: region coverage, response to events, and distributed counting.

The modules take and return arrays and frozen dataclasses; no problem file is needed.
"""
