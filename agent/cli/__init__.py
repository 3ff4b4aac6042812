"""The command line: one file a group of commands, and what they share. Imported by nothing but `agent.__main__`."""
