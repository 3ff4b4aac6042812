"""Data acquisition: blocks of one source, or of several, become uninterrupted samples in SI units.

The pipeline knows `interface` only; `agent.runtime.assembly` makes what a configuration needs.
"""
