"""Tables of a file beside its rig: baselines, consumers, the agent as a whole, what becomes of results."""
