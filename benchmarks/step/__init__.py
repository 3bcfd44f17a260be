"""Duration of a control step and its stages, beside direct calls of the libraries."""
