"""Tuned numbers of the bank: name, value, unit, and why; only the last moves more than rounding does."""

# filtering, and what uses its filters
ROWS = 16  # rows; products of this many or multiples of it give each row the same bits in OpenBLAS
CELL_TARGET = 25  # samples of a lifted cell; 10, 12, 17, 25 measured: 154, 151, 147, 124 ns a sample
CHUNK = 8192  # samples of columns at hand at once; 2000, 4096, 8192 measured: 252, 239, 232 ns a sample
BATCH = 1024  # hops summarised at once; 640, 1024, 1280, 2560 measured: 242, 232, 238, 245 ns a sample
GROUP = 8  # hops; groups of the sliding windows and of the filters' course; a power of two
SPARE = 4096  # samples that may wait beyond the longest window before the oldest are let go
RENEWED = 2  # longest windows after which a mean that does not decay starts anew; costs × 1.5
BOUNDARIES = (0.125, 0.375, 0.625, 0.875)  # of a window: where a jump is looked for
SCANS = 5  # rows of a window scanned for a jump; of 20, all cost 77 ns a sample, every 2nd 43, every 4th 25
MOST_EVENTS = 480  # lost readings whose columns are held: 2 MB, 5 ms a row; windows with more are not solved
NEGLIGIBLE = 1e-14  # relative singular value of the free responses that is rounding
UNSEEN = 1e-13  # relative singular value of what shows in no sample: an initial state, a parameter, a reading
SINGULAR = 1e-11  # ridge of the scaled information on a jump; at 1e-9 it moves a weak jump's GLR by 2e-6
STABLE = 1e-9  # a pole nearer to the unit circle does not decay
FORGOTTEN_SAMPLES = 65536  # samples in which the least force on a free mass moves an output by a sensor sd
