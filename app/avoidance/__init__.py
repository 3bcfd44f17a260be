"""Distances, acting point, and the force and acceleration of the base (Algorithm 3, §3.1)."""
