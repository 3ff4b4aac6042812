"""Tuned numbers of identification: name, value, unit, and why."""

# exact_response.py
LONGEST, MOST_PIECES = 16_384, 6  # samples of a piece, and pieces: the start needs no more
MOST_KEPT = 1200  # frequencies of a piece that are kept
FIRST_STEPS, FINALISTS = 5, 2  # steps after which the starts are compared, and how many of them go on
MOST_ROUNDS = 20  # steps of those that go on ...
RESTS_SHARE = 1e-2  # ... which rest where a step changes no parameter by this share ...
HOPELESS = 1e6  # ... and end where it was damped by so much
NEIGHBOURS = 15  # frequencies over which the errors' power is averaged
NEAR = 2.0
"""Logarithm of the errors' power by which another minimum may leave more: masses a few percent off leave as
much of the right one."""
STRETCH = 0.7  # logarithm by which a step changes a parameter at most
VAGUE = 3.0  # sd of what is known of a parameter's logarithm before: what no bin shows stays within it
# first_noise.py
TAUGHT = 3  # windows the noise is learnt from: learning from one costs a hundred times reading it
BRIEF, BRIEF_SHARE = 512, 0.1  # samples, and share of a window, of the first look at the least
FROM = 2  # windows from which that is done: one alone may rest, and is learnt from as a whole
SEARCHED = 3  # windows behind a noise whose sources are not sought on all of their grids any more
# modulation.py
FASTEST = 0.7  # of half the sample rate: beyond it what a force does between samples shows in other bins
# pooled.py
FARTHEST = 10.0  # data-sheet sds that a constant may move: beyond, the graph does not fit
MOST_STEPS, RESTS_SD = 16, 0.05  # points that are looked at, and the step, in sds, at which they end
NEAR_SD = 0.5
"""The step in standard deviations that may be left when the points are over: it widens the interval. Where
determinants move the likelihood's top from where the sum rests, or a valley of what nothing tells is curved,
0.1 to 0.45 are left beside the truth; 0.9 and more were left elsewhere."""
WORSE, PATIENCE = 1.0, 3
"""Log likelihood, over the scatter, by which a point may be worse (determinants vary by as much), and steps
after which one of them has to be better."""
HELD = 1e12  # prior precision, in relative units, of what stays at its point while likelihoods are compared
# response.py
PARTS = 4  # lengths into which a record is cut
SHORTEST_STRETCH = 64  # samples of a stretch at least
SMOOTH = 2  # order of the window: its sides fall off faster than a resonance does
MOST_BINS = 300  # bins of a response that are fitted
ROUGH, CERTAIN = 0.1, 0.5  # relative errors: what short stretches smear, and where a bin says nothing
STARTS = 32  # starts that are drawn at random ...
ROUNDS_OF_A_START = 30  # ... steps of each ...
SEED = 17  # ... and what they are drawn with: any does
FIRST_ROUNDS, FOLLOWED = 10, 12  # rounds after which guesses are compared, and how many go on
DAMPING = 0.05  # damping ratio of a guess
MOST_MINIMA, ALIKE = 6, 0.2
"""Minima that are looked at closely, and the logarithm by which parameters of one differ at most: damping is
seen less well, and tells no two apart."""
# selection.py
LEVEL = 0.02  # chance that any element that is not there is taken for one that is
RIDGE = 1e-12  # of what is known of a parameter: what no window shows would have no answer without
TIE = 2.0  # difference of scores, natural logarithms, below which two graphs are close: odds of seven to one
# start.py
SCALES = (1, 2, 4, 8)  # into how many lengths a record is cut; stretches overlap by half
ROUNDS, RESTS = 20, 1e-4  # most rounds, and the change, as a share, below which they end
STILL = 1.5  # variance of a motion, in that of its sensors' noise, below which nothing moves
