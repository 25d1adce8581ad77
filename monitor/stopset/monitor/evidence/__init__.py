"""What a violation is made of: the last seconds kept, the readings held against the model once more, a class, one file."""
