"""Covariates as rows: means of minutes, of hours where those are too old, and what is read of them."""
