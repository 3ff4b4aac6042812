"""Tuned numbers of CAN: name, value, unit, and why."""

# bus/batch.py
CALL_FRAMES = 1024  # frames taken by one system call
# bus/bus.py
READ_FRAMES = 4096  # frames that are taken at once by a read
CONNECT_S = 2.0  # s that a daemon may take to be reached and to greet
# bus/kernel.py
RECEIVE_BYTES = 4 << 20  # bytes in which frames wait with the kernel while nobody reads
# bus/netlink.py
KERNEL_ANSWER_S = 1.0  # s that the kernel may take to say how an interface is set up
# bus/slcan.py
ADAPTER_ANSWER_S = 0.3  # s that an adapter may take to answer a command
# codec/error_frames.py
AGAIN_NS = 60_000_000_000  # ns until the same state of a controller is told again
# codec/frames.py
SHOWN_BYTES = 80  # bytes of a message that is no frame that are told
# codec/joiner.py
PENDING_SAMPLES = 64  # samples that wait for their missing parts
LATE_BEFORE_RESTART = 50  # samples in a row with older counters, after which the device has begun anew
# driver.py
FEW_FRAMES = 64
"""Where fewer frames came, the bus is left alone for a while: a read costs what hundreds of frames do."""
# log/driver.py
LOG_FRAMES = 16384  # frames of a log that are handed on together
LOG_BYTES = 1 << 20  # bytes of a log read at a time; a line that is longer is cut
# log/text.py
FEW_OF_A_SHAPE = 8  # lines of a shape of which there are fewer are cheaper read one by one
# log/unmatched.py
NAMED_IDS = 5  # identifiers that are named, those seen most often first
