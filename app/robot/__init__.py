"""Robot description → model → state: what the robot is, and where it is now."""
