"""Modbus over TCP and RTU: rings, registers to poll, queues. Read requests only."""
