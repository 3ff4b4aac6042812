"""Metrics: what they are, and where they go.

Imported by the service alone.
"""
