"""Histories that left the gateway: what consumers got, read again."""
