"""Tuned numbers of Modbus: name, value, unit in the name or in the words, where from, and what needs it.

What the protocol fixes stands in `frames.py`. The tests that need these are tests/unit/drivers/modbus (units,
rings), tests/faults/test_shared_line.py and test_bad_replies.py (lost units, late replies).
"""

# ------------------------------------------------------------------ one request on a line
BUSY_FIRST_S = 0.05
BUSY_MOST_S = 1.0  # pauses after "device busy": the first, doubled up to the last
FASTEST_PACED = 22000
"""Bit/s up to which the silence before a request is 3.5 characters; faster lines keep this rate's,
about 1.75 ms (Modbus over serial line 1.02, section 2.5.1.1)."""
LONGEST_NOISE = 2048  # bytes looked through for a reply; noise before them is forgotten
UNANSWERED = 3  # requests in a row, of any units, without an answer: the connection is made anew
REMEMBERED_S = 5.0
REMEMBERED_EACH_S = 0.7  # s that a lost answer may still come: at most, and for each length asked for
FADE = 0.98  # of the slowest answer, from one answer to the next: a slow one is remembered for some fifty

# ------------------------------------------------------------------ units that do not answer
PATIENCE = 3  # requests in a row without an answer after which a unit counts as lost
SHORTEST_S = 0.05
USUAL = 4.0  # a unit is waited for so many times its slowest answer, and at least so long
FULL_FROM = 64
FULL_FROM_UNKNOWN = 16
"""Silences in a row, of a unit whose pace is known and of one whose is not, at which, and at whose doubles,
the whole time-out is waited for again."""
POLITE_S = 0.2  # for how long a request to a lost unit lets others go first
ACTIVE_S = 1.0  # a unit whose next request is due within this is one that the others share the line with
FOUND_S = 1.4
GROWTH = 4.0
RAREST = 99.0
LEAST = 3.0
"""A lost unit rests for what a request to it costs times GROWTH for each silence, at most RAREST times the
cost, and no longer than lets it be found within FOUND_S, unless that were less than LEAST times the cost."""
ROUNDING_S = 1e-6  # times this near are the same: a wait may end so much early

# ------------------------------------------------------------------ rings and polls
FIRST_S = 0.02  # the first pause between readings of a ring, before its pace is known
SHARE = 4  # a ring is asked again when this part of it may be new, if that is before the period is over
GATHER_S = 0.02  # how long a poll gathers rows before it hands them on
SLOW_S = 60.0  # s that a link is taken for slow after samples came too late; it is told once
HOPELESS = 2  # reads in a row of which most came too late: after a mere stall only the first is
NEAR = 2  # part of the ring behind the newest sample within which is read: the rest covers a read

# frames, settings
REMEMBERED_REQUESTS = 64  # requests given up whose replies are still known for what they are
RING_S, POLL_S = 0.1, 0.02
LONGEST_PERIOD_S = 86400.0  # s; a source that is asked less than once a day is none
