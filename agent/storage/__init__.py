"""SQLite: `database` (the file), `tables` (records as rows), `read`, `recovery`, `write` (the single writer).

`maintenance` is what `deltak db` and `deltak export` do. Knows nothing of blocks and of numerics.
"""
