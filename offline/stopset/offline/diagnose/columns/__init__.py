"""What a law looks like in the rows."""
