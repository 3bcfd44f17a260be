"""Programs that run the compared libraries and our controllers, each in its own environment."""
