"""Tuned numbers of the running agent: name, value, unit in the name or words, origin, and what needs it.

The tests that need these are tests/scenario (rounds, order of rounds, isolation, ends) and tests/replay
(recordings that are of no use).
"""

# ------------------------------------------------------------------ rounds of the service
READ_S = 0.2
"""How long a reader waits for samples at most before it looks whether it is to end."""
QUEUE_SAMPLES = 120_000
"""Samples that wait for the processing thread at most, a connection: two minutes at 1 kHz."""
PART = 2_000
"""Samples of one rig that are computed in its turn; where more wait, the other rigs come first."""
IDLE_S = 0.5
"""A round begins after this where nothing comes."""
LONGEST_ROUND = 5.0
"""From one round of computing to the next at most, in least times between two (`agent.round_s`) ..."""
LONGEST_ROUND_S = 0.5
"""... and at most, unless the least time is longer: where many rigs share a processor alarms are no later."""
HEALTH_PERIOD_NS = 10_000_000_000
"""From one ledger to the next, ns: of the clock while it runs, of samples in a replay."""

FIRST_FORECAST_S = 600.0
"""After a start parameters are forecast once so soon, where the time between forecasts is longer."""

# ------------------------------------------------------------------ faults and delays
PAUSE_NS = 1_000_000_000, 60_000_000_000
"""Shortest and longest pause after a fault in a rig's numerics, ns."""
RAISE_NS = 2_000_000_000
CLEAR_NS = 500_000_000
"""Computing is behind when the oldest sample waited for longer, ns, and no more when it waited for less."""

# ------------------------------------------------------------------ watching the threads
SILENCE_S = 60.0
"""How long a thread may make no progress where no service manager sets an interval (WatchdogSec)."""
LOOK_S = 1.0
"""Threads are looked at this often at least."""
WRITER_PATIENCE = 2.0
"""Intervals of the watchdog that a thread that writes may be silent, others one: a slow disk is no hang."""
PEER_PATIENCE = 10.0
"""Of those that feed consumers off the gateway: a wait for one is bounded by its timeout_s, 60 s at most."""

# ------------------------------------------------------------------ exchanging rigs
LEAVE_S = 3.0
"""How long a rig that leaves goes on with what waits; the others' samples meanwhile wait in their queues."""
RELOAD_S = 120.0
"""How long whoever asks for a reload waits for it."""
LOG_LINES = 500
"""Newest lines of the log that are kept in memory for `deltak diag`."""
# ------------------------------------------------------------------ the end
FINISH_S = 2.0
END_S = 2.8
"""How long an ending agent handles what waits (samples left are dropped and counted), and takes in all."""
HURRY_S = 1.0
ABANDON_S = 1.6
"""After being asked to end it begins no fit nor search any more, and then breaks off one under way."""
CLOSE_S = 0.6
"""How long an agent that ends waits for readers to end."""

# ------------------------------------------------------------------ what is said of recordings and runs
MOST_REPORTED = 10_000
"""Newest activations of alarms, and words of advice, that a run's document tells; the database has all."""
WATCHED = 20_000
"""Rows of a recording whose time stamps are looked at."""
MOST_REFUSED = 0.5
"""Share of a recording's rows that must be refused for one reason to be worth words."""
LITTLE = 0.01
"""A recording of which less is used is of no use."""
NEAR = 1.25
"""Two rates within this factor are the same, as far as words are concerned."""
