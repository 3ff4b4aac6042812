"""Plants of other domains, as the simulator moves them: derived by itself from topology and energies."""
