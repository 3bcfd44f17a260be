"""Plants: pybullet, MuJoCo and a kinematic stand-in behind one interface."""
