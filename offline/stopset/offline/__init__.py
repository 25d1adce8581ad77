"""From recordings to the model file, and from the model file to what it says about new recordings."""
