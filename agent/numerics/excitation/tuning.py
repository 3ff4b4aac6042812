"""Tuned numbers of the design of excitations: name, value, unit, and why."""

# design.py
ROUNDS = 20_000  # steps of the algorithm; it gains a third of the gap each time they are doubled
GAP = 2e-4  # share by which d may exceed q: by so much of the power the same could be had for less
CHECK = 50  # steps from one look at the gap to the next
LITTLE = (1e-5, 1e-6, 0.0)  # of the greatest power: lines below are left out; the next where that costs
# multisine.py
PASSES = 300  # rounds of clipping
CLIPPED = (0.85, 0.98)  # share of the peak at which is clipped, in the first round and the last
