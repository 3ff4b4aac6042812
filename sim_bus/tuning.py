"""Tuned numbers of the simulator: name, value, unit, and why."""

# clock, commands, reach
LAG_SAMPLES = 16384  # played fast, no device runs further ahead of the slowest reader than this, in samples
LINGER_S = 1.0  # With --duration the devices stay readable this long after the last sample
ALONE_S = 5.0  # after so long without a reader the command says what it waits for
LOOK_S = 0.05  # s between two looks whether all was played
SEEN_S = 10.0  # s of a scenario, its first, that must fit into its fields
SEEN_SAMPLES = 50_000  # samples of these at most
INSTANTS = 2000  # of covariates, over all that is played, a day of what has no end
BEYOND_SHARE = 0.01  # share of samples beyond a field's ends from which a scenario is not made for it

# devices/can/device, kernel
STOP_S = 5.0  # s that a device's thread may take to end
REOPEN_S = 0.1  # s until an interface that is down is tried again

# devices/modbus/device, faults, units
LISTEN_S = 0.02  # s between two looks for the end
BYTE_S = 0.0005  # s from byte to byte of a reply that comes in pieces
SLOW_SHARE = 0.5  # of the time that an answer may take, when it is slow
LATE_SHARE = 1.3  # of the same: when it is too late
NOISE_BYTES = 9  # bytes of noise before a reply
QUEUE_SAMPLES = 4096  # samples that the queue of function 24 holds; the oldest are lost beyond

# devices/oscillator, pty_line, serial_device, stream, wire_faults
MOST_JITTER = 0.45  # of a sample: samples stay in order
READ_BYTES = 65536  # bytes read from a line at a time
SETTLE_S = 0.2  # s after an opening without a sample: readers discard what came before they were set up
LINE_LOOK_S = 0.005  # s at most between two looks who has opened the line
FAST_ROOM = 512  # played fast, samples that may wait in a device for its reader
IDLE_S = 0.05  # s at most that a device rests while nothing is due
LATE_REMEMBERED = 100_000  # wake-ups, the newest, whose lateness is spread
LEAP_SAMPLES = 1000  # samples that a counter leaps over
FAR_VALUE = 1e6  # what a field that is a float shows out of its range

# rig/covariates/course
COURSE_STEPS = 256  # steps of what is felt that are computed at a time

# rig/fault_names, faults, plant, ranges, rigfile, scenario, trajectory
FAULT_S = 0.5  # s that a fault lasts where nothing is said
LOSS_SHARE = 0.2  # share of the samples that a lossy device does not send
JITTER_SHARE = 0.9  # share of the samples that a jittery device sends late
SHUFFLED_SAMPLES = 50  # samples that are shuffled among themselves
LINE_NOISE_BYTES = (24, 40)  # bytes of noise before a frame, from and to
LIFTED_STATES = 128  # states that are computed by one product
MOST_RUNS = 10_000  # runs of samples that are kept one by one
SLOW_HZ = 1.0  # rate of a device of covariates alone where nothing says so (and no faster than the rig)
NAMED = 20  # names that a fault's text lists
CHUNK = 1024  # samples of the rig's motion that are computed at a time
KEPT = 160  # chunks kept for devices: the largest ring and the widest lag between devices fit
PREPARED = 64  # rigs with parameters that have moved whose equations are kept

# virtual_time/played
START_NS = 1_000_000_000  # when sample 0 is taken
LEAD_NS = 10_000_000  # how long before that the readers may come
ANSWER_S = 0.0005  # how long a device thinks about a request
LISTEN_NS = 1_000_000  # ns between two looks at what comes while no event is due
