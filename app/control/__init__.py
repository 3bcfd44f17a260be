"""The controller (Algorithm 2): readings, references, tasks, limits, QPs and admittance law."""

CONTROLLERS = ("dbb", "hqp", "repulsive", "barrier", "none")
"""Our law (`dbb`), its step with (26) to (29) as printed (`hqp`), the compared methods
(`repulsive`, `barrier`), and our law without avoidance (`none`)."""
