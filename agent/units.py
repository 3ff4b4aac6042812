"""Units of time: nanoseconds and seconds of what the calendar counts in."""

SECOND_NS, MINUTE_NS, HOUR_NS, DAY_NS = 10**9, 60 * 10**9, 3600 * 10**9, 86_400 * 10**9
MINUTE_S, HOUR_S = 60, 3600
DAY_S, YEAR_DAYS, YEAR_S = 86_400.0, 365.25, 365.25 * 86_400.0
"""Fixed by the SI, and the year by the Julian calendar."""
