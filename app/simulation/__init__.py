"""Simulation: plants, scenarios, the live loop and the record of a run."""
