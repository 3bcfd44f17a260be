"""Measurements of the control law, which use only the public API of the project."""
