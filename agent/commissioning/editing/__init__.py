"""Small edits of a configuration's text that leave all else in it as it is."""
