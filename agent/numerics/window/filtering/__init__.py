"""Samples to whitened columns and hop summaries: filters lifted to cells, balanced coordinates, sliding sums.

Imported by the rest of `window`; it imports the model alone.
"""
