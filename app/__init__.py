"""Reactive self-collision avoidance for a differentially driven mobile manipulator.

An implementation of Jang, Kim and Park's method: a distance buffer border (DBB) around the base,
scored by the base's singularity and the arm's reachability; a force from it that moves the base out
of the arm's way; and one QP a step with continuous task transition.
"""

__version__ = "0.1.0"
