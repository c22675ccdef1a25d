"""Problem files: schema, load and save."""
