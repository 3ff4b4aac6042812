"""Recordings in files: CSV tables and NPZ arrays, streamed in blocks."""
