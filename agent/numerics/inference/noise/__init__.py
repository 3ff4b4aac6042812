"""How a rig's noise is learnt: σ by REML with a prior, a level a bin, and an intensity a source on a grid.

The likelihood is the restricted one: everything linear (initial state, parameters, constants under a wide
prior) is eliminated, so forces never explain what a mass can (Harville, J. Am. Stat. Ass. 72 (1977) 320).

`state` is what is known, `restricted_likelihood` scores σ and the bins' levels in one window, `intensities`
goes over the grids of the sources, `lines` raises bins that stand out, `after_window` is the way from what
was known before a window to what is known after it.
"""
