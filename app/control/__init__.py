"""Tasks, their QP, the controller (Algorithm 2) and the base's admittance law."""

CONTROLLERS = ("dbb", "hqp", "repulsive", "barrier", "none")
"""Our law, the controller that the paper prints, those it is compared with, and the same stack
without avoidance."""
