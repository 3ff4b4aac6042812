"""Table of the regression's tuned numbers, each with unit, source and what needs it; see the room above."""

SENSOR_CORNERS = (0.05, 0.01, 0.002)
"""Corners of coloured sensor noise, shares of the sampling rate. Needed by: AR(0.95) sensor noise."""
FORCE_CORNER_OF_SLOWEST = 0.5
"""Lowest corner of slow unknown forces, share of the slowest mode's frequency. Needed by: AR(0.99) forces."""
FORCE_CORNERS = (1.0, 4.0)
"""Corners of slow forces, in units of the lowest: one alone fits no other. Needed by: AR(0.99) forces."""
MOST_BINS = 2048
"""Most bins kept with all columns, and most bins above the cut whose residual power is used."""
HIGH_GROUPS = 16
"""Groups of bins above the cut: noise is taken as flat within each (a twelfth of a decade)."""
ALL_BINS = 24
"""Windows with fewer bins than this keep them all."""
