"""What a machine's springs and dampers are, from recordings of it."""
