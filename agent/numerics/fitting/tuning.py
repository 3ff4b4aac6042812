"""Tuned numbers of the fits: name, value, unit, and why."""

# channel_constants.py
LEAST_SHARE = 1e-3  # of an output's rms: smaller differences are nobody's fault
WIDE = 50.0  # log likelihood by which a constant must beat the readings as they are
STILL = 5.0  # an output that does not rise over so many times its noise tells nothing
FITS = 1.5  # times the noise that a scale or a delay may leave: with more it may be something else
NEAR = 1.1  # constants that leave no more times what the best leaves cannot be told from it
MARGIN = 50  # samples at either end that delays are looked for within
# channel_scale.py
LEAST_SCALE, MOST_SCALE = 1e-9, 1e9  # factors beyond these are no channel's scale
# fit.py
GREATEST = 1e60  # what a motion may grow to within a window
HALVINGS = 8  # most times that a step is halved until it leaves less
PUSHED_STEPS = 6  # most steps with unknown forces: they only bring the parameters near
FARTHEST = 0.5  # longest step downwards, as a share of the parameter; upwards twice that
# information.py
SINGULAR = 1e-14  # least eigenvalue of information of unit diagonal that says something, of the largest
# skew.py
MOST_FITS = 8  # fits at most; a delay of a third of the fastest period needs five
DELAY_SCALE_S = 0.01  # s; prior sd of a delay
MOTION_SEEN = 30.0  # times what chance explains: a stretch explained no better tells no delay
CLOSE = 0.05  # of its sd: a delay that moved by less is found
# wiring.py
FACTORS = (2.0, 10.0, 100.0, 1000.0, 1e6, 25.4, 39.3700787, 9.80665, 4.4482216)
"""How many times too large or small a reading may be: twice, prefixes, inches, kilogram- and pound-force."""
BETTER = 2.0  # a hypothesis must leave less than this part of what the readings as they are leave
WORTH = 3.0  # explanations that leave more times the best's of a stretch are not tried further
EXPLAINED = 0.5  # share of an output that an explanation may leave at most
# work.py
EVALUATION = 1500  # samples of normal work that one evaluation costs at any length (gain, lifted filters)
