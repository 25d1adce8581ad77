"""New recordings into an existing model, without the old files where they were kept."""
