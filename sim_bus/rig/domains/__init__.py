"""Plants of other domains, as the simulator moves them: derived by itself, from what joins what and from energies."""
