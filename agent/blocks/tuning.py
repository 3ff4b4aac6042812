"""Tuned numbers of the processing blocks: name, value, unit in name or words, where from, and what needs it.

A time or a count that is nobody's data sheet stands here and nowhere else; what needs it is a test under
tests/unit/blocks or tests/scenario.
"""

# ------------------------------------------------------------------ numbers of samples by counter and by time
# stamp
WIDEST = 1 << 62  # a larger counter wraps in no lifetime, one of 64 bits with the numbers themselves
RESTART_AFTER_S = 0.1  # a device that counts from behind for so long has restarted; one late frame has not
PUNCTUAL_S = 0.1  # less may be late reading only: a clock that says so tells of no silence
JOIN_S = 0.1  # counts that agree with the clock to this began anew together
LEAK = 2e-3
"""Share by which a device may be slower than its nominal rate before its samples count as late: the line of
punctual arrivals follows that much."""

# ------------------------------------------------------------------ numbers of samples by arrival
USUAL = 32  # newest arrivals of which the latest is usual
CLEAR = 0.75  # an arrival later than is usual by so much of a sample tells of lost ones at once ...
STAYS_LATE_S = 1.0
STAYS_LATE_SAMPLES = 8  # ... and as many as stay late for so long, by that much
PAUSE_READ_S = 0.06
"""Lines that flow are read less often than samples come; where one pauses, its newest sample waited so long:
the drivers' longest gathering, 0.05 s on a serial line, and a turn of the reader."""
BACKLOG_S = 1.0
FASTER = 0.02  # more are repeats: beyond a backlog, and a rate so much higher than nominal

# ------------------------------------------------------------------ clocks of devices
SETTLE_S = 2.0  # arrivals that are watched before the first sample has its time
LINE_EVERY_S = 10.0  # the line is drawn anew after twice the time again and again, and in the end this often
TRUSTED_S = 7.0  # a slope needs arrivals over at least this long; before, the rate is nominal
STEEPEST = 2e-3  # pieces run at most this much faster or slower than nominal

# ------------------------------------------------------------------ rows of several sources
PARTNER_S = 1.0  # how long a sample of one source waits for the same instant of another
TOGETHER_S = 0.5  # devices that began to count anew together have all been read again after this
NEIGHBOURS = 2  # samples within which a source must have one for a row to be made at all

# ------------------------------------------------------------------ skews
MOST_S = 0.12  # greatest skew that is looked for
STARTS_S = (0.04, 0.08, -0.03, -0.06)  # where else than at nothing a skew is looked for, until one is found
ENOUGH = 3  # stretches that must agree before rows are let go
PRECISE = 0.1  # of a sample: rows are let go when the skew is known to this
LONGER_AFTER = 4  # after so many stretches that did not tell enough the next ones are twice as long
SKEW_PATIENCE_S = 30.0
SKEW_PATIENCE_ANEW_S = 5.0  # s that rows wait for the skew, at a start and after counting began anew
EVALUATIONS = 2000
RATE = 1.0  # evaluations a first stretch may spend, and what a sample adds (in samples of work)
SKEW_EVERY_S = 10.0  # a skew that is known is measured again this often
REMEMBERED = 6  # stretches, the newest, whose skews are averaged
FLOOR = 0.01  # of a sample: what interpolation leaves, and what no measurement is better than
SMALL = 0.02  # of a sample: changes below are left alone
SHORTEST_STRETCH_S = 0.5
LONGEST_STRETCH_S = 4.0
MOST_STRETCH_SAMPLES = 4000  # a stretch that tells a skew is half the slowest mode's period, within these

# acquisition/single_source
LARGEST_READING = 1e30
"""No instrument means more, in SI: marks of "no value" (the greatest float32 is 3.4e38) and torn bytes are
beyond it, the greatest 64-bit count is not. The numerics multiply up to eight readings, at most 1e240, so
nothing overflows."""

# advisory/blind_alarms, prognosis_alarms, rest
BLIND_S = 60.0  # s that an alarm must be blind at least, where nothing is configured, before it is said
BLIND_WINDOWS = 100  # windows, the same
DEADBAND = 0.1  # of `within` and of the rate: as much as a level alarm's is of its limit
REST_S = 10.0  # s of unexcited rows after which a parameter counts as at rest

# constants_watch, estimation, rig_model, source_events, statistical_rig
SURE = 0.95  # probability from which on a hypothesis is said
DROPPED = 0.5  # probability below which it is taken back
WORTH_A_ROW = 0.05  # change of a probability that is stored
ALARM = 0.99  # probability that raises a sensor alarm when it lasts
ALARM_WINDOWS = 10  # windows that it must last, from the end of the first
TIED = 0.15  # share of the probability that each of several explanations has that cannot be told apart
MOST_STUCK = 0.05  # share of a window that dry friction may hold: a hold is known no better than the model
AUTOMATIC_WINDOWS = 5  # windows of "auto": each twice the one before
STRICTLY_STABLE = 1.0 - 1e-6  # largest pole radius with which an observer may run on uncorrected
STANDS = 1e-6  # of the fastest pole: a slower one is at zero (a free rig's are found to 1e-8 only)
SETTLE_NS = 250_000_000  # ns that signs gather before the cause is named: late samples come first
QUIET_NS = 1_000_000_000  # an episode is over when nothing was counted for so long
SHARE_OF_MATRIX = 0.1  # of a matrix's size: stands for the size of an entry that is 0 at nominal

# covariates/means
MEMORY_PERIODS = 7200  # periods remembered (five days): a lag of 21 h has forgotten all but 0.3 %
