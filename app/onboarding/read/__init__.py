"""Reading a URDF: links, joints, arm, base, limits, masses.

A file that cannot become a robot raises a RobotFileError. The message names the fault, such as a
missing file, an invalid number or a probably wrong unit, and a remedy.
"""
