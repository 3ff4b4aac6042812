"""Tuned numbers of commissioning: name, value, unit in the name or the words, where from, and what needs it.

The tests that need these are tests/unit/commissioning (checks, channels, observer).
"""

# ------------------------------------------------------------------ listening to sources
LISTEN_S = 5.0
"""How long is listened, counted from when every source has been heard."""
PATIENCE_S = 5.0
"""How long a source may take until its first sample."""
TURN_S = 0.1
"""How long is waited for arrivals at a time."""
OFF_RATE = 0.02
"""Share by which samples may come faster or slower than configured."""
DRIFTS_PPM = 200.0
"""A clock that surely drifts by more is worth a word."""

# ------------------------------------------------------------------ noise of channels, from readings
ORDER = 6
"""Of the difference that takes out the motion and leaves the noise."""
REACH = 24
AHEAD = 2
"""Readings of a force that may show in one of an output, and how many of them come after it."""
LEAST_ROWS = 10
MOST_ROWS = 50_000
"""Rows for each number that is fitted, and of all that is gone by."""
CALM = 0.2
"""Of an input's rms: what differences leave beyond is no noise but the force itself."""

# ------------------------------------------------------------------ channels that may be exchanged, scaled or
# late
LEVELS = 10
"""Different readings that two channels must show: coarse ones may well agree on fewer."""
STRETCHES = 2
"""Stretches of a recording that are examined, those that move most."""
PLAINER = 2.0
"""A zero, a scale or a delay must leave less than this part of what mended wires or signs leave."""

# ------------------------------------------------------------------ what windows will tell
FORCE_RMS = 1.0
"""N (or the input's own unit): what is assumed where no recording says how the rig is excited."""
DECAY_FROM = 0.01
"""m (or the state's own unit): where a rig without a measured force is let go."""
GUESSED_NOISE = 1e-3
"""Of an output's rms, where nothing is known of its noise."""
MOST_GROWN = 1e12
"""A model whose motion grows so many times within a window is no prediction's business."""
SETTLE_MOST = 50_000
SPAN_MOST = 40_000
"""Samples that are simulated at most until motion has settled, and beyond the longest window."""

# ------------------------------------------------------------------ warnings
MARGINAL = 1e-9
"""A pole this near the unit circle neither decays nor grows."""
FEW_A_PERIOD = 20
"""Samples a period below which a straight line between samples is not what a force did."""
FEWER_A_PERIOD = 8
"""Samples a period below which a cubic is not either."""
LIVELY = 1e-3
"""Damping ratio above which a mode that oscillates counts as one with a period worth a window."""
