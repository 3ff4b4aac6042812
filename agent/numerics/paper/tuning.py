"""Tuned numbers of the paper's methods: name, value, unit, and why."""

# recentring.py
DEPENDENT = 1e-2  # least singular value of combinations of length 1 that are independent
# seed.py
RANK_TOLERANCE = 1e-12  # directions of a batch with less than this share of the strongest count as empty
# seed_window.py
RUN_AWAY = 1e60  # states of an observer that is stable no more, whose squares are figures still
ENOUGH, DEVIATIONS = 0.01, 3.0  # of a parameter, and times its sd: what passes may have still to go
SLOWEST = 0.98  # ratio of two steps beyond which the series' rest is taken for 50 steps: it may not end
