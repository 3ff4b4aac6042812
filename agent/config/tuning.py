"""Tuned numbers of the configuration: bounds of its values and defaults that several places need."""

# domains/frames
ROUND_OFF = 1e-12  # of a matrix of ones and zeros: what is smaller is 0

# model/linear_files
MATRIX_BYTES = 50_000_000  # bytes of a file with a plant's matrices, which are small

# reading/fields, toml_file, units
LONGEST_SKEW_S = 0.5  # s that a channel may be sampled later than the others
LEAST = 1e-30
GREATEST = 1e30  # sizes of numbers beside 0: any quantity in any unit, whose squares are numbers too
FILE_BYTES = 2_000_000  # bytes of a configuration, which is a short text
UNIT_LETTERS = 3  # of what is no word: of so few letters each may be another unit

# rules_constants, rules_estimator, rules_linear
MOST_PERCENT = 50.0  # beyond it a constant is not known but for its sign: it is to be estimated
MOST_SPREAD = 5.0  # spread of a noise of which nothing is known
MOST_GB = 1.0  # what the linearised samples of a window may take
COPIES = 6  # how often they are in memory meanwhile, as measured on a million samples of two masses
LEAST_EVERY_S = 1.0  # between two forecasts of a parameter
SAME_RATE = 1e-6  # share by which the rate of a model and that of its rig may differ by rounding
UNSTABLE = 1.0 + 1e-6  # radius of a sampled pole beyond which a motion grows, by more than rounding

# sections/covariates, north, process
BASELINE_CLASSES = 5  # classes of a covariate that the machine must have run in for a baseline ...
BASELINE_DAYS = 1.0  # ... and days of it
ARCHIVE_ROWS = 2000  # instants of an archive's file: of four parameters some 8,000 rows, 400 kB
ROUND_S = 0.2  # s from one round of computing to the next: alarms are later by half of it, a core does less
