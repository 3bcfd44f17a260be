"""Sweeps: paths towards the base from all directions (`dbb sweep`)."""
