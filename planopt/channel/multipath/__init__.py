"""Small-scale fading: its laws, draws of it, and what it does to connectivity."""
