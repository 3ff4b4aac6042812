"""Simulated Modbus devices: registers, replies, faults of replies, servers."""
