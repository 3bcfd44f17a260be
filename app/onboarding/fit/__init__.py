"""Fitting bodies, groups, reachability and postures to a robot."""
