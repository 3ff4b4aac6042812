"""Serial lines: binary frames, delimited frames, lines of text. Nothing is ever written."""
