"""Distances, acting point, accelerations, activation, and the avoidance task (Algorithm 3, §3.1-3.3)."""
