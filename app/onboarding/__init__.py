"""A robot of one's own: from its URDF to a description, a border and a report; and its check."""
