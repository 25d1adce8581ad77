"""Which effect comes next."""
