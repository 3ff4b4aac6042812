"""`deltak serve`: the page and the HTTP API, a process of its own that only reads the databases."""
