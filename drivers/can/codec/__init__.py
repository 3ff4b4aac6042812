"""CAN frames to samples, as a DBC file says. Pure: no I/O."""
