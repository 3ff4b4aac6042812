"""Covariates as they come: means of minutes, and references moved by what the machine feels of them."""
