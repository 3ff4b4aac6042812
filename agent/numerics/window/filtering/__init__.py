"""Samples to whitened columns and summaries of hops: filters lifted to cells, balanced coordinates, sliding sums.

Imported by the rest of `window`; it imports the model alone.
"""
