"""The demo: a simulated device and the agent on a real local bus, held against the truth."""
