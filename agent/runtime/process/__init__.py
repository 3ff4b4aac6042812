"""The agent as a process: heap, opening of databases, an end to whatever is computed, alarms on stderr.

Imported by the service and its rigs alone.
"""
