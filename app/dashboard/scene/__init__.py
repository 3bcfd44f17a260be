"""Three-dimensional scene."""
