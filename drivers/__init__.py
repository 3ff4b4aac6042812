"""deltak's drivers: buses and recordings behind one small interface: `drivers.port`. Imports neither agent nor sim_bus."""
