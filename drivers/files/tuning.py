"""Tuned numbers of recorded files: name, value, unit, and why."""

# csv_file, driver, npz_file, resolution, table
LONGEST_HEADER = 1 << 20  # bytes of a first line; a file with a longer one is no table
LONGEST_ROW = 1 << 22  # characters; the same of a row
CHUNK_BYTES = 1 << 24  # bytes read at once, however long the first row is; reading takes eleven times as many
LEVELS, HELD = 8, 10  # commanded is what has fewer levels, each of which it keeps for so many samples
LARGE_BYTES, PACKED_WELL = 1 << 28, 100  # bytes unpacked, and times more than packed, at most
LONGEST_ARRAY_HEADER = 1 << 16  # bytes that describe an array of numbers take a hundred
RESOLVED = 1e-9  # of the largest reading: below this a step cannot be told from the rounding of decimal text
ON_GRID, NEARLY_ALL = 0.01, 0.99  # readings are on a grid if so many are within a share of a step
CLOSEST = 50  # differences of neighbouring levels, the smallest, whose common divisor is looked for
FEW = 8  # fewer levels than this are on a grid only if it goes through zero: two are always one length apart
BLOCK_ROWS = 65536  # rows handed on together
