"""Self-contained pages and files that people read."""
