"""Buses and recordings behind one small interface: `drivers.port`. Imports neither agent nor sim_bus."""
