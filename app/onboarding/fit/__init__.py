"""Fitting bodies, groups, joint limits and postures to a robot."""
