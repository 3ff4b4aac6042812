"""Scored scenarios: played from end to end on simulated time, held against what they expect."""
