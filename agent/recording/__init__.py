"""Raw recordings: what sources delivered, kept as it came, and what of it is kept around alarms.

Imported by runtime.
"""
