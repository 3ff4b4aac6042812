"""What all commands share: documents and tables on the terminal, streams, signals, logs, errors, exit codes.

Imported by the other rooms of the command line.
"""
