"""Tuned numbers of models: name, value, unit, and why."""

# identifiability.py
TOLERANCE = 1e-7  # singular values of the Jacobian of unit columns, of the largest, that count as 0
SILENT = 1e-11  # a column shorter than this share of what its factors could give is no trace but round-off
ANGLE = 1.0  # rad; of the ray on which s lies, between the real axis and the imaginary (poles)
HALF_RATE = 2.5  # rad a sample; farthest point of a model in discrete time, below half the rate, pi
# observer.py
WEAKEST, STRONGEST, STRIDE = -8.0, 8.0, 2.0
"""Decades of the intensity searched, about that of which the readings show 1 in units of their noise."""
BISECTIONS = 7  # of a stride: the intensity is found to 4 %
# riccati.py
MOST_STEPS = 60  # doublings: 2^60 samples are more than any rig will see
SETTLED = 1e-14  # relative change of the covariance at which it has settled
LOOKS = 6  # doublings over which the readings show the states: 64 samples
UNSHOWN = 1e-12  # of the best: a correlated predictor's state that readings show no better is not shown
REMEMBERED = 1e-7  # a predictor with a pole nearer to the unit circle never forgets its start
# scales.py
SAME = 1e-9  # of what cancels: two derivatives that differ by less are the same but for round-off
# statespace.py
BLOCK = 32  # samples that are simulated by one product
GONE = 1e-12  # a pole in discrete time of less than this leaves nothing of a motion after a sample
# stick_slip.py
SPEED = 50.0
"""Slowest pole of the observer, 1/s: with 100 the noise of a 0.1 mm sensor at 1 kHz reverses the velocity."""
SLOWEST, FASTEST = 0.02, 0.3  # least and most that its slowest pole may forget in one sample
DEVIATIONS, REST = 3.0, 2.0
"""A velocity that stays within so many deviations of its noise for REST over SPEED rests, and where friction
takes less than that in a sample, no share of it can be told: it is 0."""
STILL = 1e-9  # a velocity below this share of what friction takes away in a sample is none
