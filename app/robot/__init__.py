"""Robot description → model → state: the robot's data, its base pose, posture and velocities."""
