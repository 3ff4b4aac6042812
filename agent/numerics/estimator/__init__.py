"""The product's estimator: windows strung together over the life of a rig, with its policy of change."""
