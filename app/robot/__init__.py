"""Robot description → model → state: the robot's data, and its present configuration."""
