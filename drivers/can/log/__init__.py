"""CAN logs: recorded frames as a source that ends, and what is kept of a bus for them."""
