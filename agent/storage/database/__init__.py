"""The file: schema, views, checksums and their verification, connections, and what lies beside it."""
