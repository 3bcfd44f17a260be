"""Measurements by which the control law is judged, through the project's public API only."""
