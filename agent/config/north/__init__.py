"""Consumers beyond the gateway ([[north]]): their table."""
