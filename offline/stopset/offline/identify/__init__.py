"""From recordings to the model file, stage by stage."""
