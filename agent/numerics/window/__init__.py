"""Streaming bank: what every window says of the parameters, at a cost a sample independent of its length."""
