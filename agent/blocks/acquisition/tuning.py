"""Tuned numbers of acquisition: name, value, unit in the name or in the words, where from, and what needs it.

A time or a count that is nobody's data sheet stands here and nowhere else; what needs it is a test under
tests/unit/blocks/acquisition or tests/scenario.
"""

# ------------------------------------------------------------------ numbers of samples by counter and by time
# stamp
WIDEST = 1 << 62
"""A larger counter does not wrap in any lifetime, and one of 64 bits wraps with the numbers themselves."""
RESTART_AFTER_S = 0.1
"""A device that keeps counting from behind for this long has restarted; a single late frame has not."""
PUNCTUAL_S = 0.1
"""Samples that are late by less may only have been read late: a clock that says so tells of no silence."""
JOIN_S = 0.1
"""Counts that agree with the clock to this began anew together."""
LEAK = 2e-3
"""Share by which a device may be slower than its nominal rate before its samples count as late: the line of
punctual arrivals follows that much."""

# ------------------------------------------------------------------ numbers of samples by arrival
USUAL = 32
"""Newest arrivals of which the latest is usual."""
CLEAR = 0.75
"""An arrival later than is usual by so much of a sample tells of lost ones at once ..."""
STAYS_LATE_S = 1.0
STAYS_LATE_SAMPLES = 8
"""... and as many as stay late for so long, by that much."""
PAUSE_READ_S = 0.06
"""Lines that flow are read less often than samples come; where one pauses, its newest sample waited so long:
the drivers' longest gathering, 0.05 s on a serial line, and a turn of the reader."""
BACKLOG_S = 1.0
FASTER = 0.02
"""More samples than time allows are repeats: beyond a backlog, and a rate so much higher than nominal."""

# ------------------------------------------------------------------ clocks of devices
SETTLE_S = 2.0
"""Arrivals that are watched before the first sample has its time."""
LINE_EVERY_S = 10.0
"""The line is drawn anew after twice the time again and again, and in the end this often."""
TRUSTED_S = 7.0
"""A slope is taken from arrivals over at least this long; before that, the nominal rate is assumed."""
STEEPEST = 2e-3
"""Pieces run at most this much faster or slower than nominal."""

# ------------------------------------------------------------------ rows of several sources
PARTNER_S = 1.0
"""How long a sample of one source waits for the same instant of another."""
TOGETHER_S = 0.5
"""Devices that began to count anew together have all been read again after this."""
NEIGHBOURS = 2
"""Samples within which a source must have one for a row to be made at all."""

# ------------------------------------------------------------------ skews
MOST_S = 0.12
"""Greatest skew that is looked for."""
STARTS_S = (0.04, 0.08, -0.03, -0.06)
"""Where else than at nothing a skew is looked for, until one is found."""
ENOUGH = 3
"""Stretches that must agree before rows are let go."""
PRECISE = 0.1
"""Of a sample: rows are let go when the skew is known to this."""
LONGER_AFTER = 4
"""After so many stretches that did not tell enough the next ones are twice as long."""
SKEW_PATIENCE_S = 30.0
SKEW_PATIENCE_ANEW_S = 5.0
"""Rows wait no longer than this for the skew, at a start and after a device began to count anew."""
EVALUATIONS = 2000
RATE = 1.0
"""Evaluations a first stretch may spend at once, and what each sample adds (in samples of work)."""
SKEW_EVERY_S = 10.0
"""A skew that is known is measured again this often."""
REMEMBERED = 6
"""Stretches, the newest, whose skews are averaged."""
FLOOR = 0.01
"""Of a sample: what interpolation leaves, and what no measurement is better than."""
SMALL = 0.02
"""Of a sample: changes below are left alone."""
SHORTEST_STRETCH_S = 0.5
LONGEST_STRETCH_S = 4.0
MOST_STRETCH_SAMPLES = 4000
"""A stretch that tells a skew is half a period of the slowest mode, within these."""
