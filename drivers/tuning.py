"""Tuned numbers of what all drivers share: name, value, unit, and why."""

# pipe, port, reconnect, conformance
READ_BYTES = 65536  # bytes read from a line at a time
RETRY_S, RETRY_HERE_S = 1.2, 0.4
"""Longest pauses between tries to open a source, so that it is read again within 2 s of its return: of one
that is reached over a network, and of one whose absence this machine knows by itself."""
FIRST_S = 0.1  # s; the first pause between tries to open a source, doubled up to the longest
DEADLINE_S = 20.0  # s within which what the port promises must have happened
CONFORMANCE_READ_S = 0.05  # s that a read is given
