"""deltak's drivers: buses and recordings behind one small interface, `drivers.port`. They import no other package."""
