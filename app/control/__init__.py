"""Tasks, the hierarchical QP, the controller (Algorithm 2) and the base's admittance law."""
