"""Tuned numbers of the fits: name, value, unit, and why."""

# fit.py
EVALUATION = 1500  # samples of normal work that one evaluation costs at any length (gain, lifted filters)
GREATEST = 1e60  # what a motion may grow to within a window
HALVINGS = 8  # most times that a step is halved until it leaves less
PUSHED_STEPS = 6  # most steps with unknown forces: they only bring the parameters near
FARTHEST = 0.5  # longest step downwards, as a share of the parameter; upwards twice that
# skew.py
MOST_FITS = 8  # fits at most; a delay of a third of the fastest period needs five
DELAY_SCALE_S = 0.01  # s; prior sd of a delay
MOTION_SEEN = 30.0  # times what chance explains: a stretch explained no better tells no delay
CLOSE = 0.05  # of its sd: a delay that moved by less is found
