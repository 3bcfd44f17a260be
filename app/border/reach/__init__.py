"""Reachability maps (§2.3.2): the density of inverse kinematics solutions, by the area formula."""
