"""Reading a URDF: links, joints, arm, base, limits, masses."""
