"""What ``stopset demo`` is made of: commands as a user types them, the cell they run beside, and what must hold of both."""
