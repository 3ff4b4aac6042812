"""Tuned numbers of recorded files: name, value, unit, and why."""

# csv_file, driver, npz_file, resolution, table
LONGEST_HEADER = 1 << 20  # bytes of a first line; a file with a longer one is no table
LONGEST_ROW = 1 << 22  # characters; the same of a row
CHUNK_BYTES = 1 << 24  # bytes read at once, however long the first row is; reading takes eleven times as many
LEVELS, HELD = 8, 10
"""Something is commanded if it has fewer levels than this, and stays at each so many samples on average."""
LARGE_BYTES, PACKED_WELL = 1 << 28, 100
"""Bytes unpacked, and times that they may be more than packed: numbers with noise pack to half or a tenth."""
LONGEST_ARRAY_HEADER = 1 << 16  # bytes that describe an array of numbers take a hundred
RESOLVED = 1e-9  # of the largest reading: below this a step cannot be told from the rounding of decimal text
ON_GRID, NEARLY_ALL = 0.01, 0.99
"""Readings are on a grid if nearly all of them are within this share of a step of it."""
CLOSEST = 50  # differences of neighbouring levels, the smallest, whose common divisor is looked for
FEW = 8  # fewer levels than this are on a grid only if it goes through zero: two are always one length apart
BLOCK_ROWS = 65536  # rows handed on together
