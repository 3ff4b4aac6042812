"""Consumers of rows beyond the gateway: how far each has them, and what was purged before it had."""
