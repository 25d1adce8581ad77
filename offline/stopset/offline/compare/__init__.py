"""Model against measurements: where it fails, and on what that depends."""
