"""The distance buffer border: points around the mobile robot, their score, their file."""
