"""Streaming bank: what every window says of the parameters, at a cost a sample that does not grow with the window."""
