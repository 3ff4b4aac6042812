"""Recordings on their way through a pipeline."""
