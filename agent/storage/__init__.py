"""SQLite: the file, records as rows, the single writer, read-only queries, recovery, maintenance.

Imported by recording, runtime, commissioning, evaluation and the command line.
"""
