"""Prognosis (PA): whether a parameter changes, when it reaches a limit, and how good such forecasts were.

`change` tests for a trend apart from its shape, `steps` finds steps, `forecast` tells the first passage of a
limit over a `family` of laws whose parameters `posterior` weighs (particles, each with a Kalman `filter`) and
`passage` follows onward; `learnt` is what like machines teach; `scores` and `crossing` hold forecasts against
what came.
"""
