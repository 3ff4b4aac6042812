"""What runs: clock, registry, pipeline, recorder, service, command line."""
