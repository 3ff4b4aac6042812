"""Tuned numbers of the store: name, value, unit, and why."""

# database/checksum, columns, compaction, connect, files, verify
CHECKSUM_FEW = 400  # rows up to so many are taken one by one: all at once takes 0.6 ms whatever their number
CHECKSUM_ROWS = 2048  # rows whose bytes stay in the processor's cache while their columns are walked
ROWS_AT_ONCE = 64  # of 20 columns at the most: a statement may have 32,766 values
COPIED_PAGES = 4096  # pages copied back between two looks for an end: a few milliseconds' worth
SPILL_BYTES = 10 * 1024 * 1024  # bytes in the log after which rows go to a side file
WAL_BOUND = 16 * 1024 * 1024  # bytes that the write-ahead log may take whatever readers do
BALLAST_BYTES = 3 * 1024 * 1024  # freed when the disk is full: SQLite needs room even to delete
HEAD_BYTES = 256 * 1024  # bytes in which marks of our own files are looked for where the header is damaged
READ_BYTES = 1024 * 1024  # bytes of a file read at a time
SMALL_PAGES = 4096  # files up to this size are read whole at every start
NEWEST_ROWS = 5000  # rows of each table, the newest, that are proved at every start of a larger file

# read/forward, points, proof, queries, recent, tables
BATCHES_A_CONNECTION = 200  # after so many the file is opened anew, and its small tables are proved anew
MOST_POINTS = 50_000  # more points than this and a trend reads a coarser tier
ROWS_READ = 20_000  # rows that are held in Python's objects at a time
INSTANTS_READ = 2000  # instants whose rows are given on at a time: 8 MB with four parameters
POINTS_READ = 1000
"""A row in Python's objects takes ten times as much memory as in arrays; so few are as quick as more."""
HEALTH_ROWS = 400  # the newest rows of health that are looked through for sources: a row of each every 10 s
LONGEST_LINE = 1 << 22  # characters; a file with a longer line is no table
LARGEST = 1e100  # magnitude beyond which no parameter of a machine lies and squares overflow

# recovery/page_carving, salvage
CARVING_ROWS = 10_000  # rows of a table that are carved before they are written
LEAP_ROWS = 100_000  # numbers skipped after a loss, so that none is given out twice
KEPT_ASIDE = 3  # damaged files kept; a sick flash must not fill itself with them

# tables/ages, clocks, estimates, notifications, rows, run_rows
CONFIRMED_NS = 24 * 3600 * 10**9  # running time that stamps cover once a wall clock is confirmed
CONFIRMED_RUNS = 2  # runs, the same
AGE_SLEW = 1e-3  # a wall clock that is drawn to another runs at most this much faster or slower
MOST_ANCHORS = 1000  # anchors of a wall clock that are kept, the newest
SAME = 1e-9  # of an sd: what lower and upper may differ from value -+ t95 sd and still be left out
NORMAL_DOF = 1e9  # degrees of freedom from which on Student's t is normal; the file holds no infinity
MOST_ERROR = 300  # characters that are kept of what went wrong
MOST_FITS = 10_000  # fits whose numbers are remembered, the newest; an older one gets another number
CELLS_A_COMMIT = 20_000  # about 1.2 MB of write-ahead log

# write/alarm_commands, backlog, command_socket, decimation, notifications, retention, rollups, store,
# watermark
LONGEST_SHELF_NS = 7 * 86_400 * 10**9  # ns; for longer an alarm is to be mended or switched off
COMMENT_LETTERS = 1000  # characters of a comment
COMMAND_ALARMS = 1000  # alarms that one command may name
BOUNDS_S = (0.1, 0.2, 0.5, 1.0, 1.5, 2.0, 5.0, 10.0, 60.0)
"""Upper ends of the bins, s; one more bin takes all beyond. Rows wait for a batch a second."""
SHORTEST_S, LONGEST_S = 0.2, 5.0  # s that a failing disk is left alone: first, and, doubled, at most
FEW_CELLS = 64  # cells below which batches are joined: waiting rows cost little more than their bytes
LONGEST_REQUEST = 65536  # bytes of a line that is asked
LONGEST_ANSWER = 1 << 26  # a status is 350 bytes a rig, a log 500 lines
PATIENCE_S = 5.0  # s that a caller may take to send its line or to take its answer
LIFE_SIGN_S = 1.0  # s between signs of life while a command is under way
CONNECTIONS_WAITING = 16  # whose line is not complete; of more the one that has waited longest is cut off
MOST_COMMANDS = 4  # done at a time
BEFORE_S = 10.0
AFTER_S = 60.0  # s before and after a change of an alarm for which all rows are kept
MOST_NAMED = 1000  # notifications that one command may name
KEPT_RECORDS = 100_000  # events, alarms, verdicts, forecasts ..., 20 to 50 MB each: years of a quiet rig
FREE_PAGES = 128  # pages of the file that are free: with more a full disk costs no rows
LATE_NS = 30 * 10**9  # rows kept for an alarm reach the store up to 10 s after later ones
PART_NS = 3600 * 10**9  # ns of rows that are aggregated and purged at a time
OPEN_PARTS = 3  # parts of a run that rows may still come for
HOPS_A_PURGE = 10_000  # rows that are deleted in one transaction: new ones come between two
TIER_S = 365 * 86400  # s; a tier kept longer counts for so long in what the file may need
HOP_BYTES, CELL_BYTES, SPREAD_BYTES, HEALTH_BYTES, COVARIATE_BYTES = 47.0, 47.0, 38.0, 60.0, 77.0
"""Bytes that a row of each table takes in the file, as measured."""
LEAST_SD = 1e-150  # a noise-free replay may claim an sd of zero, whose weight would be infinite
CHECKPOINT_EVERY = 300  # commits after which the log is copied into the file ...
CELLS_A_CHECKPOINT = 20_000  # ... or rows in them
LAG_MEMORY_NS = 5 * 86_400 * 10**9  # five times the longest lag of a machine behind a covariate
MOST_AHEAD = 4_000_000  # rows that a log and a side file can hold; a note further ahead is none
MOST_RECENT = 1 << 18
"""Rows of a run that wait for their minutes in memory: 19 MB, ten minutes of 4 parameters at 100 Hz."""
