"""Explanations why there is no verified plan, by the problem file's keys, and what helps."""
