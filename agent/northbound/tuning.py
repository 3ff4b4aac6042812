"""Tuned numbers of what is sent northbound: name, value, unit, and why."""

# forwarder, position
PAUSE_S = (1.0, 30.0)  # s after a failed attempt, first and, doubled, at most; randomly up to half shorter
LATE_S = 5.0  # s behind from which a consumer gets what is new first, and what it lacks as backfill
KEEP_S = 5.0  # s between storings of cursors: what was acknowledged since is sent again after a crash
FILL_S = (0.1, 0.4)  # s that a batch of what is lacking is to take: what is new comes between two
ROUND_S = 5.0  # a round begins after this where nothing is stored
STORE_S = 2.0  # until a database that cannot be read is tried again
MOST_GAPS = 32  # gaps that are kept apart; beyond it the shortest stretch between two is sent again with them

# mqtt/connection
MESSAGES_AT_ONCE = 100  # messages that wait for their acknowledgement together, unless the broker takes fewer
LOOK_S = 0.2  # s between two looks whether the agent ends
LEAVE_S = 1.0  # s that a broker may take to take leave
