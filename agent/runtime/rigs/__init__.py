"""The rigs of a running agent: what belongs to them, and how some are exchanged while the others go on.

Imported by the service and by telemetry.
"""
