"""Alarms as ISA-18.2 has them: the life cycle of one, and what is measured of many."""
