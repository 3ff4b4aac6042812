"""Configuration: TOML files to checked models."""
