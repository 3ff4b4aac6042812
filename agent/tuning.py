"""Tuned numbers of the agent's clock: name, value, unit, and why."""

# clock.py
STEP_NS = 1_000_000_000  # settings of the wall clock that are nearer to one another are one, ns
SLEW = 1e-3  # labels run at most this much faster or slower than nominal while they follow the device's drift
SETTLE_NS = 10_000_000_000  # how long arrivals are watched before labels are drawn towards the wall clock
DEAD_ZONE_NS = 50_000_000  # ns; labels that are nearer to the wall clock are not drawn
