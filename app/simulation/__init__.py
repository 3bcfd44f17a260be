"""Simulation: plants, people, scenarios, sessions, runs, the live loop and traces of runs."""
