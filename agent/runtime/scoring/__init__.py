"""Scenarios played from end to end on simulated time, and what the agent made of them held against what was played."""
