"""Measurements of speed, control and robustness: `python -m benchmarks.NAME` in the checkout."""
