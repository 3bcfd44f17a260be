"""Scenarios: where a run starts, and what leads the end-effector."""
