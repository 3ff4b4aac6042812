"""One record at a time: maximum-likelihood fits, likelihoods of disturbances, colour and information."""
