"""Covariates of a configuration as models: channels beside the model's, and what baselines make of them."""
