"""Distances, acting point, accelerations, activation, avoidance task (Algorithm 3, §3.1-3.3)."""
