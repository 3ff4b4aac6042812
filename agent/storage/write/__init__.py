"""The single writer: its thread, its transactions, rollups, retention, and commands from other processes."""
