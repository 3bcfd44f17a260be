"""Reachability maps (§2.3.2) by counting inverse kinematics solutions."""
