"""CAN interfaces: the kernel, a socketcand daemon, serial adapters, python-can."""
