"""Motions that teach most: optimal power over frequencies, and signals of little peak that carry it."""
