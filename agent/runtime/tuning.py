"""Tuned numbers of the running agent: name, value, unit in the name or words, origin, and what needs it.

The tests that need these are tests/scenario (rounds, order of rounds, isolation, ends) and tests/replay
(recordings that are of no use).
"""

# ------------------------------------------------------------------ rounds of the service
READ_S = 0.2  # how long a reader waits for samples at most before it looks whether it is to end
QUEUE_SAMPLES = 120_000  # samples of a connection that wait to be computed: two minutes at 1 kHz
PART = 2_000  # samples of one rig that are computed in its turn; where more wait, the other rigs come first
IDLE_S = 0.5  # a round begins after this where nothing comes
LONGEST_ROUND = 5.0  # between two rounds of computing, in least times between (`agent.round_s`) ...
LONGEST_ROUND_S = 0.5  # ... and s, unless that is longer: many rigs on a processor alarm no later
HEALTH_PERIOD_NS = 10_000_000_000  # ns between ledgers, of the clock, of samples in a replay

LEARNT_S = 60.0
"""s of samples between two storings of what was learnt, 70 kB each: a drift is learnt from every window, and
a second's windows would wear out a card by that alone, 6 GB a day."""
FIRST_FORECAST_S = 600.0  # s after a start until the first forecast, where forecasts are rarer

# ------------------------------------------------------------------ faults and delays
PAUSE_NS = 1_000_000_000, 60_000_000_000  # shortest and longest pause after a fault in a rig's numerics, ns
RAISE_NS = 2_000_000_000
CLEAR_NS = 500_000_000  # ns that the oldest sample waited where computing falls behind, and is no more
BEGINNING_NS, BEGINNING_RAISE_NS = 60 * 10**9, 20 * 10**9
"""ns that a rig begins, and for so long its oldest sample may wait meanwhile: thirty rigs of 1 kHz that learn
their first windows on one core were 9 s behind, on two 2 to 3 s; nothing is lost by it."""

# ------------------------------------------------------------------ watching the threads
SILENCE_S = 60.0  # s that a thread may make no progress where no service manager says (WatchdogSec)
LOOK_S = 1.0  # threads are looked at this often at least
WRITER_PATIENCE = 2.0  # watchdog intervals that a writer may be silent, others one: disks are slow
PEER_PATIENCE = 10.0  # of those that feed consumers elsewhere: a wait is bounded by timeout_s, 60 s

# ------------------------------------------------------------------ exchanging rigs
LEAVE_S = 3.0  # s that a rig that leaves goes on with what waits; the others' samples wait meanwhile
RELOAD_S = 120.0  # how long whoever asks for a reload waits for it
LOG_LINES = 500  # newest lines of the log that are kept in memory for `deltak diag`
# ------------------------------------------------------------------ the end
FINISH_S = 2.0
END_S = 2.8  # s that an ending agent handles what waits (the rest is dropped, counted), takes in all
HURRY_S = 1.0
ABANDON_S = 1.6  # s after it is asked to end until it begins no fit, and until it breaks off one
CLOSE_S = 0.6  # how long an agent that ends waits for readers to end

# ------------------------------------------------------------------ what is said of recordings and runs
MOST_REPORTED = 10_000  # alarms and words of advice, the newest, in a run's document; a database has all
WATCHED = 20_000  # rows of a recording whose time stamps are looked at
MOST_REFUSED = 0.5  # share of a recording's rows that must be refused for one reason to be worth words
LITTLE = 0.01  # a recording of which less is used is of no use
NEAR = 1.25  # two rates within this factor are the same, as far as words are concerned

# playing, replay
MOST_BLOCKS = 5000  # between two pauses: what they lead to, some 35 MB, waits until it is stored
COMMIT_S = 0.05  # between commits: little is left to write when the last block is estimated
SWITCH_S = 5e-4
"""Longest that reading and writing hold the interpreter while the estimation, which lets go of it in every
product of matrices, waits for it: a tenth of a replay at Python's 5 ms; below 0.2 ms switching costs more."""
COLLECTION_EVERY = 200_000
"""New objects between two searches for garbage, of which arrays make none: 20,000 cost a hundredth of all."""

# process/deadline, memory, opening, watch
ON_ITS_WAY_S = 0.5  # s that an exception which is to break off a fit may take to arrive
LARGE_BYTES = 128 * 1024  # glibc's first threshold, which it raises to 32 MB: a heap keeps its peaks
OPENING_LOOK_S = 0.05  # s between two looks for the end while databases are opened
LOOKS_AN_INTERVAL = 4  # threads are looked at this often at least in an interval of the watchdog

# reestimation/keeping, pools, reestimate
WRITER_STOP_S = 600.0  # s that a database's writer may take to write what waits
SCHEDULER_S = 30.0  # how long a scheduler may take to answer, and to have a worker
MOST_TRIES = 3  # processes that may die over one part: the third time it is the part that ends them

# telemetry/exporters
TEXTFILE_S = 15.0  # from one writing of the file to the next: as often as Prometheus asks by default

# workers/child, databases, link, piped, worker
WORKER_END_S = 5.0  # how long a worker whose agent ended may take to end
AGAIN_S = 1.0  # until runs are begun again that a failing disk does not let begin
MOST_SPARE = 1000  # messages that wait; what can be spared is not sent where more do
MOST_CELLS = 200_000  # rows that wait for the agent at most, a database: as many as wait for a disk
SCORE_ADDED = 200  # added to a worker's score for Linux's out-of-memory killer: it goes before the agent

# forecasts/histories, making, schedule, scoring, thread
HISTORY_MEANS = 1000  # means a history is thinned to: a year costs little more than a day
FORECAST_ROWS = 10_000
"""Rows that a forecast reads: of longer histories minutes, then hours, as of a day's rows the arrays alone
took a tenth of a small agent's memory."""
MOMENT = 60.0  # a history shorter than this part of the time between forecasts is too short
FORECASTS_AT_ONCE = 100  # instants made up for; where more have passed nothing was recorded meanwhile
ALARM_FORECASTS = 60  # forecasts at alarms are apart by this part of the time between others
LONG_TIMES = 2.0  # times as long as until its P90 has passed, when a forecast is scored anyway
SETTLE_S = 2.0  # how long after it was asked a forecast is begun, so that the rows that led to it are stored
PRIORITY_STEPS = 5
"""Less priority than the agent's other threads, in steps of nice(2). At the lowest it would be put aside
while it holds the interpreter's lock, and a thread that reads a bus would wait for it."""
FORECASTS_WAITING = 64  # what was made and not fetched; the oldest goes

# forwarded/postgres
ROWS_READ = 20_000  # rows of a database that are held at a time
