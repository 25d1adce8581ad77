"""The daemon: listens to the arm, checks every measurement against the model, publishes what a stop would take now."""
