"""What may reach the server, and what may not."""
