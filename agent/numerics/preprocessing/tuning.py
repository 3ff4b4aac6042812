"""Tuned numbers of preprocessing: name, value, unit, and why."""

# cleaning.py
LONGEST_SPIKE = 3  # readings of the longest spike
NEAR = 8  # readings before the doubtful one that it is held against
BLOCK = 128  # samples over which the usual size of a second difference is taken ...
THIN = 4  # ... of every fourth of them: the median is the dearest part of all this.
MEMORY = 4  # blocks back whose greatest size counts, so that motion just begun is usual soon
EXCESS = 10.0  # a second difference this many times the usual one is in doubt
CLEAR = 4.0  # a spike stands out this many times more than its two sides differ from each other
DOUBTFUL = 1.5  # an input that stands out so many times more is in doubt: the motion decides
EXCESS_OF_INPUTS = 6.0  # the same for EXCESS
CROWD = 32  # samples before a suspect input in which ...
CROWDED = 12  # ... no more second differences may be in doubt (two spikes): so is the signal, else
WILD = 1e5
"""An isolated input so many times beyond what is usual and beyond every reading before it is a spike whatever
the motion says: no sensor resolves that much, and sums of its square would leave no digit for those that come
after."""
CONTEXT = 64  # samples that are kept as they came, against which the next ones are tested
STEPS = 4.0  # nothing below this many steps of the wire is in doubt
# drift.py
BINS = 256
"""Stretches of time of which the most punctual arrival is kept; when there are more, neighbours are joined,
and from stretches of `LONGEST_S` on the oldest are forgotten: over hours a crystal follows the weather."""
BIN_S, LONGEST_S = 0.25, 4.0  # length of a stretch, at first and at most
LEAST_BINS = 8  # stretches below which there is no line
SPREAD_S = 1e-4  # least scatter of the most punctual arrivals: what a system's timer leaves
CAUTION = 1.6  # a hull's edge scatters more than a line through all points; measured, by its test
# noise.py
ROUND_OFF = 1e-10  # share of a signal's peak below which differences are the computer's own
# rails.py
PLATEAU = 4  # equal readings that may be a clipped peak ...
OVERSHOOT = 16.0  # ... if the motion would have gone so many steps (or noise) further: round ones go 4
SURE_OVERSHOOT = 32.0  # the same where no second such peak follows: healthy 16-bit channels reached 25
BRAKED_OVER = 3  # samples before the last whole step into a top over which its braking is told
BRAKING = 3.5
"""Times the speed lost in each of them: the last whole step of a motion that was braked to rest is no more.
Constant braking makes 1.5 to 2, up to 3 where it begins only then; braking that fades makes 1 to 2 until its
steps are ..."""
CREEP = 3.0  # ... those of the wire, of which it then makes no more than so many a sample.
REST = 0.5  # an input that is at one value for so much of the time rests there
ALIKE = 0.8
"""Share of a flat top's value from which on readings have its step, where steps grow with values. Of the few
nearer ones the divisor is often a multiple of the step, and clips are missed."""
WHOLE = 1e-6  # share of a step by which a reading may miss a whole number of them, and of a power of ten that
ROUNDING = 1e-9  # share of a reading up to which differences are rounding: 30 bits, more than a sensor has
SAME = 1e-12
"""Share of a reading by which one that is the same may miss it: some thousand rounding errors of a double.
What was filled in does (sensor_watch.py), and a force that is computed settles on its value by some thirty of
them at once. No wire has 40 bits. Needed by: a square wave behind two lags."""
# resample.py
ON_A_SAMPLE = 1e-6  # of a sample: a place this near to a reading is that reading
# sensor_watch.py
ENTRY = 16  # samples before a standstill over which the speed is taken with which it was entered
# standing.py
SMOOTH = 20.0  # a range this many times the noise is motion whatever the channel did before
LIVELY = 0.3  # a range of this share of the channel's usual one is motion too
MOVES = 8.0  # nothing below this many steps of the wire is motion
SHORTEST = 24  # samples that a channel must stand still, while others move, at least
PATIENT, LONGEST = 3, 4  # times longer than in health that it must stand still; windows at most
FADE = 0.995  # what is left of a channel's usual range after a block in which something moved
ABRUPT = 32.0  # steps that it must have missed to be no turning point, which misses eight to eighteen
CHUNK = 64  # blocks: how far a channel went is remembered over one to two times so many
FURTHER = 6.0  # share of their way that others must have gone, times the root of the channel's steps ...
WIDE = 0.7  # ... where that is no more than this share; else they must have gone half of their way ...
TRIPS, MORE = 4, 1.5  # ... so often, without going so many times further than before; ...
FEWEST = 24.0  # ... and a channel of fewer steps tells nothing.
APART = 20.0  # a channel that never moved is missed where one of its kind went over so many of its steps
