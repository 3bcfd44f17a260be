"""The controller (Algorithm 2): readings, references, tasks, limits, QPs and admittance law."""

CONTROLLERS = ("dbb", "hqp", "repulsive", "barrier", "none")
"""Our law (`dbb`), its step with the hierarchy (26) to (29) (`hqp`), the compared methods
(`repulsive`, `barrier`), and our law without avoidance (`none`)."""
