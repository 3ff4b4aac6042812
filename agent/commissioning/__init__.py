"""Commissioning: what a configuration can and cannot do, and what its channels show; nothing is stored.

Imported by the command line.
"""
