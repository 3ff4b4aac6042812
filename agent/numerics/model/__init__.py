"""Rigs as state-space models with exact derivatives, seen through sensors, and the observers of such models."""
