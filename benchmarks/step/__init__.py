"""How long a control step takes, and what it is made of, beside the bare calls of the libraries."""
