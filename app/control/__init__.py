"""Tasks, their QP, the controller (Algorithm 2) and the base's admittance law."""

CONTROLLERS = ("dbb", "repulsive", "barrier", "none")
"""The paper's method, those it is compared with, and the same stack without avoidance."""
