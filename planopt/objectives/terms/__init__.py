"""The terms that an objective is the weighted sum of: one file a term, open to further ones."""
