"""Evaluation: the agent against known truth: demo, scored scenarios, paper. Imported by the command line."""
