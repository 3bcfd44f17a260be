"""Physics, scenarios, the two-rate loop and recording."""
