"""The tables of the model and its channels, and what of them can be estimated."""
