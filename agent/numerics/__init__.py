"""Pure mathematics: numpy and scipy only; no clock, no input or output, no logging, no configuration.

Rooms, each built on those before: `model` (rigs and observers), `preprocessing` (what channels deliver),
`window` (the streaming bank) beside `inference` (one window, in the frequency domain), `estimator` (the
product's own) beside `fitting` (one window alone), `paper` (the method it grew from). Imported by blocks and
by whatever stands above them.
"""

from agent.numerics import lean_import as lean_import  # before anything imports scipy
