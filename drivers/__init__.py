"""deltak's drivers: buses and recordings behind one interface, `drivers.port`. Imports no other package."""
