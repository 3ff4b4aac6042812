"""Evaluation: the agent against known truth: demo, scored scenarios, the paper. Imported by the command line."""
