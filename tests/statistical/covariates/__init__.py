"""Machines whose stiffness follows the weather, at the level of estimates and of samples."""
