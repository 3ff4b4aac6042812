"""Covariates as they come: means of minutes, and references that are moved by what the machine feels of them."""
