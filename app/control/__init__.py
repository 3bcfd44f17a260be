"""Tasks, their QP, the controller (Algorithm 2) and the base's admittance law."""

CONTROLLERS = ("dbb", "hqp", "repulsive", "barrier", "none")
"""Our law, the paper's controller as printed, the compared methods, and the same controller
without avoidance."""
