"""Upgrades: what a version would do to databases and configurations, and a switch that takes itself back."""
