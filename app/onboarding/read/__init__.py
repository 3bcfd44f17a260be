"""Reading a URDF: links, joints, arm, base, limits, masses.

The files are untrusted. What cannot become a robot raises a RobotFileError, whose message names the
fault, such as a missing file, an invalid number or a probably wrong unit, and a remedy.
"""
