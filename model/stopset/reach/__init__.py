"""Where the arm can be: flowpipes of the identified model and bounds on its stops."""
