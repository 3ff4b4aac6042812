"""Commissioning: what a configuration can and cannot do, and what its channels show. Nothing is stored."""
