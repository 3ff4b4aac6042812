"""Tuned numbers of serial lines: name, value, unit, and why."""

# codec, driver, patterns, text
FLUSH_FRAMES = 16  # frames' worth of rubbish that is counted though no good frame has come
LINE_PERIOD_S = 0.05  # s between reads of a flowing line: a read costs what hundreds of bytes do
FEW_BYTES = 1024  # bytes; a read that got more is followed by the next at once
LONGEST = 1024  # characters of the longest line that is held against a pattern
EFFORT = 20.1  # powers of two: two free repeats over a line of 1024 characters, some ten milliseconds
SHOWN_LETTERS = 60  # characters of a rejected line that a note shows
