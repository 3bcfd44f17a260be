"""Measurements of speed; run one with `python -m benchmarks.<name>` from the checkout."""
