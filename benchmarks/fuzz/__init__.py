"""A fuzz of what strangers can send or hand over: messages of a page, and files."""
