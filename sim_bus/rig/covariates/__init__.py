"""What surrounds a rig: covariates that are read beside its signals and move its parameters."""
