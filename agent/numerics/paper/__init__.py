"""The estimator of the paper that this product grew from, as printed and over a sliding window."""
