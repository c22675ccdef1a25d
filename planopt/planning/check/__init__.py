"""Verification of saved plans and runs from their files alone."""
