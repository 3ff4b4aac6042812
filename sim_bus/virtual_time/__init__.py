"""Devices on simulated time: the same bytes and faults, without a bus and without waiting."""
