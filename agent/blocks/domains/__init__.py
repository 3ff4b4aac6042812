"""Templates of other domains on their way from the configuration to the mathematics."""
