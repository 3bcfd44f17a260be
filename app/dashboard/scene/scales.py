"""How long an arrow is."""

METRES_PER_NEWTON = 1 / 400  # [m/N] of a force: 0.1 m is 40 N
METRES_PER_ACCELERATION = 0.2  # [s²] of v̇: 0.2 m is 1 m/s²
RADIANS_PER_ACCELERATION = 0.4  # [s²] arc of ω̇: 0.4 rad is 1 rad/s²
LEAST_FORCE = 0.5  # [N] weaker forces get no arrow, whose head would be longer than itself
