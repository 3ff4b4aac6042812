"""Tuned numbers of the paper's method and its conditions: name, value, unit, and why."""

# margins_box.py
MOST_PARAMETERS = 8  # the polytopic margin has 2^q vertices, each of them a matrix inequality
# recentring.py
DEPENDENT = 1e-2  # least singular value of combinations of length 1 that are independent
# region.py
MOST_VERTICES = 256  # vertices that are all tried; of more, as many drawn at random
FLIPPED = 6  # of those drawn so many, the worst, are improved
INSIDE = 32  # points inside the box that are tried
STARTS = 2  # of the worst points so many are searched from
OFFSET = 1e-3  # how far inwards from a vertex a measure is looked at, in halves of the box
SEED = 19  # any does
# seed.py
RANK_TOLERANCE = 1e-12  # directions of a batch with less than this share of the strongest count as empty
# seed_window.py
RUN_AWAY = 1e60  # states of an observer that is stable no more, whose squares are figures still
ENOUGH, DEVIATIONS = 0.01, 3.0  # of a parameter, and times its sd: what passes may have still to go
SLOWEST = 0.98  # ratio of two steps beyond which the series' rest is taken for 50 steps: it may not end
