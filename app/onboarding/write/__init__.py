"""Writing the description, its URDF and its report."""
