"""Tuned numbers of the design of excitations: name, value, unit, and why."""

# design.py
ROUNDS = 20_000
"""Steps of the algorithm at most; it gains about a third of the gap each time the steps are doubled."""
GAP = 2e-4
"""Share by which d may exceed q: by this share of the power at the most the same could be had for less."""
CHECK = 50  # steps from one look at the gap to the next
LITTLE = (1e-5, 1e-6, 0.0)
"""Shares of the greatest power below which a line is left out; the next one where that costs too much."""
# multisine.py
PASSES = 300  # rounds of clipping
CLIPPED = (0.85, 0.98)  # share of the peak at which is clipped, in the first round and the last
