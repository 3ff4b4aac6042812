"""Tuned numbers of CAN: name, value, unit, and why."""

# bus/batch, bus, kernel, netlink, slcan
BATCH_FRAMES = 1024  # frames taken by one system call
READ_FRAMES = 4096  # frames that are taken at once by a read
CONNECT_S = 2.0  # s that a daemon may take to be reached and to greet
RECEIVE_BYTES = 4 << 20  # bytes in which frames wait with the kernel while nobody reads
KERNEL_ANSWER_S = 1.0  # s that the kernel may take to say how an interface is set up
ADAPTER_ANSWER_S = 0.3  # s that an adapter may take to answer a command

# codec/error_frames, frames, joiner
AGAIN_NS = 60_000_000_000  # ns until the same state of a controller is told again
SHOWN_BYTES = 80  # bytes of a message that is no frame that are told
PENDING_SAMPLES = 64  # samples that wait for their missing parts
LATE_BEFORE_RESTART = 50  # samples in a row with older counters, after which the device has begun anew

# driver
FEW_FRAMES = 64  # frames; after fewer the bus is left alone a while: a read costs what hundreds do

# log/driver, text, unmatched
LOG_FRAMES = 16384  # frames of a log that are handed on together
LOG_BYTES = 1 << 20  # bytes of a log read at a time; a line that is longer is cut
FEW_OF_A_SHAPE = 8  # lines of a shape of which there are fewer are cheaper read one by one
NAMED_IDS = 5  # identifiers that are named, those seen most often first
