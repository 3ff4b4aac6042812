"""The way from nothing to a configuration that runs: examples, a first file, and what its sources deliver."""
