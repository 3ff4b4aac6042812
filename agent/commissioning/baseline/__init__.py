"""Baselines: what parameters are like on a healthy machine, learnt from its own stored rows."""
