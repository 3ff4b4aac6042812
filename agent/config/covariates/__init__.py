"""Covariates of a configuration: channels beside the model's, and the table that says what baselines make of them."""
