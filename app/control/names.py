"""Names of the controllers, which need nothing of them."""

CONTROLLERS = ("dbb", "repulsive", "barrier", "none")
"""The paper's method, those it is compared with, and the same stack without avoidance."""
