"""Simulated CAN devices and the buses and adapters that they sit on."""
