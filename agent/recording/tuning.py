"""Tuned numbers of recording: name, value, unit, and why."""

# ages, event_writer, events, folder, recorder, states
SAVE_S = 600.0  # s between savings of the time that ran: a power cut loses so much, files stay longer
MOST_JOBS = 8  # records that wait for the disk; of more the newest is given up
MOST_BYTES = 64 << 20  # of blocks that wait in memory for an alarm
OBJECT_BYTES = 1024  # bytes of a block beside its numbers: most, where samples come one at a time
LONGEST_RECORD = 4  # alarms raised meanwhile lengthen a record to at most so many times its after_s
STATES = 3
"""States of the pipeline that wait in memory for an alarm, over a megabyte each: one for each half of what a
record holds before it, and one for alarms of samples that are not the newest."""
LEAST_STATE_S = 0.25  # from one state to the next at least: each takes a few milliseconds
PATIENCE_S = 2.0  # a record ends this long after its time even if no samples come
LEAST_FREE = 64 << 20  # bytes of the disk, or a tenth of a small one, that recordings leave to the database
FLUSH_S = 1.0  # s that samples wait at most before they are written
SEGMENT_BYTES = 16 << 20  # bytes of a file, after which the next one begins
SEGMENT_S = 3600.0  # a file that is older ends even when it is small, so that an age can be kept to
STATE_BYTES = 16 << 20  # of a pipeline; more would cost more to remember than to explain is worth
