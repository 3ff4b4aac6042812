"""Rigs over several processes: workers read buses and compute, the agent itself writes, commands and watches.

Imported by the command line and by the processes themselves alone.
"""
