"""The rows a diagnosis stands on, and their noise."""
