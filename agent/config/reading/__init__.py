"""From the text of a file to values: TOML, kinds of values, units, what is wrong in words, tables."""
