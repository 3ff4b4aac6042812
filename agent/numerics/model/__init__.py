"""Rigs as state-space models with exact derivatives, seen through sensors, and observers of such models."""
