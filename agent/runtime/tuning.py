"""Tuned numbers of the running agent: name, value, unit in the name or words, origin, and what needs it.

The tests that need these are tests/scenario (rounds, order of rounds, isolation, ends) and tests/replay
(recordings that are of no use).
"""

# ------------------------------------------------------------------ rounds of the service
READ_S = 0.2  # how long a reader waits for samples at most before it looks whether it is to end
QUEUE_SAMPLES = 120_000
"""Samples that wait for the processing thread at most, a connection: two minutes at 1 kHz."""
PART = 2_000  # samples of one rig that are computed in its turn; where more wait, the other rigs come first
IDLE_S = 0.5  # a round begins after this where nothing comes
LONGEST_ROUND = 5.0
"""From one round of computing to the next at most, in least times between two (`agent.round_s`) ..."""
LONGEST_ROUND_S = 0.5
"""... and at most, unless the least time is longer: where many rigs share a processor alarms are no later."""
HEALTH_PERIOD_NS = 10_000_000_000
"""From one ledger to the next, ns: of the clock while it runs, of samples in a replay."""

FIRST_FORECAST_S = 600.0
"""After a start parameters are forecast once so soon, where the time between forecasts is longer."""

# ------------------------------------------------------------------ faults and delays
PAUSE_NS = 1_000_000_000, 60_000_000_000  # shortest and longest pause after a fault in a rig's numerics, ns
RAISE_NS = 2_000_000_000
CLEAR_NS = 500_000_000
"""Computing is behind when the oldest sample waited for longer, ns, and no more when it waited for less."""

# ------------------------------------------------------------------ watching the threads
SILENCE_S = 60.0
"""How long a thread may make no progress where no service manager sets an interval (WatchdogSec)."""
LOOK_S = 1.0  # threads are looked at this often at least
WRITER_PATIENCE = 2.0
"""Intervals of the watchdog that a thread that writes may be silent, others one: a slow disk is no hang."""
PEER_PATIENCE = 10.0
"""Of those that feed consumers off the gateway: a wait for one is bounded by its timeout_s, 60 s at most."""

# ------------------------------------------------------------------ exchanging rigs
LEAVE_S = 3.0
"""How long a rig that leaves goes on with what waits; the others' samples meanwhile wait in their queues."""
RELOAD_S = 120.0  # how long whoever asks for a reload waits for it
LOG_LINES = 500  # newest lines of the log that are kept in memory for `deltak diag`
# ------------------------------------------------------------------ the end
FINISH_S = 2.0
END_S = 2.8
"""How long an ending agent handles what waits (samples left are dropped and counted), and takes in all."""
HURRY_S = 1.0
ABANDON_S = 1.6
"""After being asked to end it begins no fit nor search any more, and then breaks off one under way."""
CLOSE_S = 0.6  # how long an agent that ends waits for readers to end

# ------------------------------------------------------------------ what is said of recordings and runs
MOST_REPORTED = 10_000
"""Newest activations of alarms, and words of advice, that a run's document tells; the database has all."""
WATCHED = 20_000  # rows of a recording whose time stamps are looked at
MOST_REFUSED = 0.5  # share of a recording's rows that must be refused for one reason to be worth words
LITTLE = 0.01  # a recording of which less is used is of no use
NEAR = 1.25  # two rates within this factor are the same, as far as words are concerned

# playing, replay
MOST_BLOCKS = 5000
"""Between two pauses: what they lead to is some 35 MB, and waits in memory until it is stored."""
COMMIT_S = 0.05  # between commits: little is left to write when the last block is estimated
SWITCH_S = 5e-4
"""Longest that reading and writing hold the interpreter while the estimation, which lets go of it in every
product of matrices, waits for it: a tenth of a replay at Python's 5 ms; below 0.2 ms switching costs more."""
OBJECTS = 20_000
"""New objects between two searches for garbage, of which arrays make none: 700 cost a hundredth of all."""

# process/deadline, memory, opening, watch
ON_ITS_WAY_S = 0.5  # s that an exception which is to break off a fit may take to arrive
LARGE_BYTES = 128 * 1024
"""glibc's own first threshold, raised to 32 MB once a large array was freed; a heap then keeps its peaks."""
OPENING_LOOK_S = 0.05  # s between two looks for the end while databases are opened
LOOKS_AN_INTERVAL = 4  # threads are looked at this often at least in an interval of the watchdog

# reestimation/keeping, pools, reestimate
WRITER_STOP_S = 600.0  # s that a database's writer may take to write what waits
SCHEDULER_S = 30.0  # how long a scheduler may take to answer, and to have a worker
MOST_TRIES = 3  # processes that may die over one part: the third time it is the part that ends them

# telemetry/exporters
TEXTFILE_S = 15.0  # from one writing of the file to the next: as often as Prometheus asks by default

# workers/child, databases, link, piped, worker
ORPHAN_S = 5.0  # how long a worker whose agent ended may take to end
AGAIN_S = 1.0  # until runs are begun again that a failing disk does not let begin
MOST_SPARE = 1000  # messages that wait; what can be spared is not sent where more do
MOST_CELLS = 200_000  # rows that wait for the agent at most, a database: as many as wait for a disk
MORE_EXPENDABLE = 200  # added to a worker's score for Linux's out-of-memory killer: it goes before the agent

# forecasts/histories, making, schedule, scoring, thread
HISTORY_MEANS = 1000
"""Means that a history is thinned to at once, so that a year of rows costs little more than a day."""
MOMENT = 60.0
"""A history shorter than this part of the time between forecasts is too short, whatever it looks like."""
FORECASTS_AT_ONCE = 100
"""Instants that are made up for at once; where more have passed nothing was recorded meanwhile."""
ALARM_FORECASTS = 60
"""Forecasts of one parameter at alarms are apart by this part of the time between others at least."""
LONG_TIMES = 2.0
"""A forecast is scored, though nothing came, when so many times as long as until its P90 has passed."""
SETTLE_S = 2.0  # how long after it was asked a forecast is begun, so that the rows that led to it are stored
NICER = 5
"""Less priority than the agent's other threads, in steps of nice(2). At the lowest it would be put aside
while it holds the interpreter's lock, and a thread that reads a bus would wait for it."""
FORECASTS_WAITING = 64  # what was made and not fetched; the oldest goes

# forwarded/postgres
ROWS_READ = 20_000  # rows of a database that are held at a time
