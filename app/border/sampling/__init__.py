"""Sampling of P_i (Algorithm 1), sector by sector, on all cores."""
