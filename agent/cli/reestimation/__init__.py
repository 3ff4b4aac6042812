"""`deltak reestimate`."""
