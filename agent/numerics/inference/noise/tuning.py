"""Tuned numbers of how noise is learnt: one table, each with its unit, its source and what needs it."""

SIGMA_WALK = 0.1
"""Prior sd of log σ's random walk from window to window. Needed by: jitter, whose noise grows with speed."""
SIGMA_WALK_DOF = 4.0
"""Windows this prior counts for; what windows then show falls to 0.03 on a steady rig. Needed by: jitter."""
LEVEL_DOF = 30.0
"""Prior degrees of freedom of each frequency bin's noise level (scaled inverse χ²). Needed by: 50 Hz hum."""
LINE_POWER = 16.0
"""Power of a bin, in that of its neighbours, from which it is a line: chance e^-16. Needed by: 50 Hz hum."""
LINE_NEIGHBOURS = 25
"""Bins on either side of a line that it is held against."""
LINE_CYCLES = 8
"""Cycles a window that a line has at least: what is slower is the work of forces."""
FORGET = 0.97
"""Factor a window on the log-weights of force and colour intensities. Needed by: forces that begin."""
SHAKEN = 0.1
"""The same for a window that only other noise explains: sources are looked for as in a first window."""
UNSETTLED = 0.05
"""Change of an intensity's logarithm from which every window is learnt from. Needed by: forces that cease."""
LARGE_NODES = 20.0
"""An intensity beyond this many first nodes is followed so: a weak one moves by chance. Cost only."""
SURE = 3.0
"""Log-weight of "absent" below the best node from which an intensity that changes is followed. Cost only."""
NODES = 44
"""Nodes of the grid of each intensity; fewer stop short of the forces of EMPS. Needed by: EMPS."""
NODE_RATIO = 1.6
"""Ratio of adjacent nodes: a quarter decade, finer than a window tells intensities apart (log sd ≥ 0.3)."""
FIRST_NODE = 0.1
"""First node as a share of the intensity that equals the white sensor noise where the source is strongest."""
LOWEST_LOG_WEIGHT = -30.0
"""Floor of carried log-weights: the chance that an intensity jumps anywhere in a window is e^-30."""
ROTATION = 40
"""Intensities scanned in a window besides the active ones. Cost only: every one has its turn."""
ACTIVE_NODES = 5.0
"""An intensity beyond this many first nodes is scanned in every window."""
PRIOR_ABSENT = 0.5
"""Prior probability that a source of noise is absent. Needed by: right models near the bound."""
