"""The command line: one file a command group, and what they share. Imported only by `agent.__main__`."""
