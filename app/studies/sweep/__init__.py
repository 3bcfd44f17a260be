"""Sweeps: paths towards the base from everywhere (`dbb sweep`)."""
