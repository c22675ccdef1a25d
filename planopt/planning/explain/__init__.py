"""Why there is no verified plan, in the problem file's words, and the least change that helps."""
