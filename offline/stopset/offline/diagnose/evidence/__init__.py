"""How likely an effect is, given the rows."""
