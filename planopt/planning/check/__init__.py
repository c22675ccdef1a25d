"""Judging saved plans and runs again, from their files alone."""
