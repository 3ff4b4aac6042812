"""One window fitted alone, when something is asked before or beside the estimates.

What is wired, scaled or delayed wrongly, how far two sources are apart in time, and the least that anybody
could know.
"""
