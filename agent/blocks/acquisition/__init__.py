"""Data acquisition: blocks of one source, or of several, become uninterrupted samples in SI units."""
