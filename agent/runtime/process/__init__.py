"""The agent as a process: its heap, the opening of its databases, and an end to whatever is computed.

Imported by the service alone.
"""
