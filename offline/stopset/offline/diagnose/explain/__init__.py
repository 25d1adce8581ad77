"""What to tell the user about the result."""
