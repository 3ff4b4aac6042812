"""Pure mathematics: numpy and scipy only; no clock, no input or output, no logging.

Rooms, each built on those before: `model` (rigs and observers), `readings` (what channels deliver), `window` (sliding
windows from shared blocks), `fitting` (one record at a time), `faults` (what may be wrong), `estimator` (the product's
own), `paper` (the method it grew from). Beside them what is done with estimates: `trend`, `exceedance`.
"""
