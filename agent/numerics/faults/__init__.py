"""What may be wrong with a model or its channels: suspects, mistakes, wrong masses, skews, and the verdict."""
