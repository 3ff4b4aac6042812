"""Which graph explains a machine."""
