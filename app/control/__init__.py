"""Tasks, their one QP, the controller (Algorithm 2) and the base's admittance law."""
