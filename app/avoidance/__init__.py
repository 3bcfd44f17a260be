"""Distances, acting point, accelerations, activation, the avoidance task (Algorithm 3, §3.1-3.3)."""
