"""Tuned numbers of the paper's methods: name, value, unit, and why."""

# recentring.py
DEPENDENT = 1e-2
"""Least singular value of the combinations, each of length 1, below which they count as dependent."""
# seed.py
RANK_TOLERANCE = 1e-12  # directions of a batch with less than this share of the strongest count as empty
# seed_window.py
RUN_AWAY = 1e60
"""States of an observer that is not stable any more, small enough for their squares to be figures."""
ENOUGH, DEVIATIONS = 0.01, 3.0
"""Share of a parameter's size, and times its sd, that passes may have still to go; it is added to the sd."""
SLOWEST = 0.98
"""Ratio of two steps beyond which the rest of the series is taken for 50 steps: it may as well not end."""
