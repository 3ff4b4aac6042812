"""Buses and recordings behind one small interface: `drivers.port`. Imports neither agent nor sim_bus.

A room a kind of bus: `can`, `modbus`, `serial`, `files`; none knows another, all share what lies beside.
"""
