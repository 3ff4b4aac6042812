"""The state of all rigs at one moment, as a document and as a frame of a terminal."""
