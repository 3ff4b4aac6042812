"""One window fitted alone, for questions before or beside the estimates.

What is wired, scaled or delayed wrongly, how far two sources are apart in time, and the least that anybody
could know.
"""
