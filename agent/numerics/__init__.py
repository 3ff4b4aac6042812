"""Pure mathematics: numpy and scipy only; no clock, no input or output, no logging."""
