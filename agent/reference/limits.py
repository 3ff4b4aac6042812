"""Limits that a healthy machine seldom crosses, and the smallest change that they find.

A healthy change is x + e: x slow, of sd s and correlation time tau, e the noise of windows, of sd e. An alarm
with on-delay D needs every row of D beyond limit + t e, t the quantile of its confidence; so it is raised no
more often than the mean of D lies beyond that, whose sd is S = sqrt(s^2 + e^2 w/(w + D)), w the window.
Departures of a stationary Gaussian process beyond z sd come z phi(z)/tau times a second (the
Ornstein-Uhlenbeck process, Leadbetter, Lindgren and Rootzen 1983, theorem 12.3.5), tau that of the mix; z
follows from how many false alarms are allowed, and limit = z S - t e. Spread that rests on few independent
hours is taken at the upper end of its 95 % interval.
"""

from dataclasses import dataclass
from math import exp, inf, log, pi, sqrt

from scipy.optimize import brentq
from scipy.special import chdtri, ndtri

from agent.reference.tuning import FOUND, MARGIN, SURE, WORTH
from agent.units import YEAR_S

DELAYS = tuple(2.0**i for i in range(8))
"""On-delays that are weighed, in windows."""


@dataclass(frozen=True, slots=True)
class Healthy:
    """How a parameter of a healthy machine moves.

    Attributes:
        spread_sd, correlation_s: sd and time constant of its slow part.
        n_effective: independent hours that the spread was learnt from.
        row_sd: sd of a row about the slow part, as the rows state it.
        scatter_sd: the same as rows showed it.
        window_s: what a row rests on; hop_s: from one row to the next.
        least: limits below this leave rows unexcited.
    """

    spread_sd: float
    correlation_s: float
    n_effective: float
    row_sd: float
    scatter_sd: float
    window_s: float
    hop_s: float
    least: float = 0.0

    @property
    def noise_sd(self) -> float:
        """The sd of a row, the larger of what is stated and what was seen."""
        return max(self.row_sd, self.scatter_sd)


@dataclass(frozen=True, slots=True)
class Limit:
    """A limit and its on-delay; false_per_year at the most; the change it finds, and how soon."""

    limit: float
    on_delay_s: float
    false_per_year: float
    finds: float
    finds_within_s: float


def proposed(healthy: Healthy, per_year: float, confidence: float = 0.95) -> Limit:
    """Return the limit that finds the smallest change with no more than so many false alarms a year."""
    ways = [_with_delay(healthy, factor * healthy.window_s, per_year, confidence) for factor in DELAYS]
    least = min(way.finds for way in ways)
    return next(way for way in ways if way.finds <= WORTH * least)


def false_per_year(healthy: Healthy, limit: float, on_delay_s: float, confidence: float = 0.95) -> float:
    """Return how many false alarms a year a limit allows at the most."""
    S, tau = _mean_of(healthy, on_delay_s)
    z = (limit + _margin(healthy, confidence)) / S if S > 0.0 else inf
    return _rate(float(z), tau) * YEAR_S


def _with_delay(healthy: Healthy, on_delay_s: float, per_year: float, confidence: float) -> Limit:
    S, tau = _mean_of(healthy, on_delay_s)
    margin = _margin(healthy, confidence)
    limit = max(_quantile(per_year, tau) * S - margin, MARGIN * healthy.noise_sd, healthy.least, 1e-300)
    windows = max(on_delay_s / healthy.window_s, 1.0)
    all_beyond = float(ndtri(FOUND ** (1.0 / windows))) * healthy.noise_sd
    finds = limit + margin + sqrt(all_beyond**2 + (float(ndtri(FOUND)) * _upper(healthy)) ** 2)
    within = on_delay_s + healthy.window_s + healthy.hop_s
    return Limit(limit, on_delay_s, false_per_year(healthy, limit, on_delay_s, confidence), finds, within)


def _margin(healthy: Healthy, confidence: float) -> float:
    """Return by how much a row must lie beyond the limit to be surely beyond it."""
    return float(ndtri(confidence)) * healthy.row_sd


def _mean_of(healthy: Healthy, on_delay_s: float) -> tuple[float, float]:
    """Return sd and correlation time of the mean change over an on-delay."""
    slow = _upper(healthy) ** 2
    noise = healthy.noise_sd**2 * healthy.window_s / (healthy.window_s + on_delay_s)
    if slow + noise <= 0.0:
        return 0.0, healthy.window_s
    fast_s = healthy.window_s + on_delay_s
    rate = (slow / max(healthy.correlation_s, fast_s) + noise / fast_s) / (slow + noise)
    return sqrt(slow + noise), 1.0 / rate


def _upper(healthy: Healthy) -> float:
    """Return the upper end of the spread's interval, by chi-squared of its independent hours less one."""
    dof = max(healthy.n_effective - 1.0, 1.0)
    return healthy.spread_sd * sqrt(dof / float(chdtri(dof, SURE)))


def _rate(z: float, tau: float) -> float:
    """Return how often a second a process leaves +-z sd; its asymptote from one sd on."""
    if z > 38.0:
        return 0.0
    z = max(z, 1.0)
    return 2.0 * z * exp(-0.5 * z * z) / sqrt(2.0 * pi) / tau


def _quantile(per_year: float, tau: float) -> float:
    """Return z at which departures beyond +-z sd come so many times a year."""
    wanted = per_year / YEAR_S
    if _rate(1.0, tau) <= wanted:
        return 1.0
    return float(brentq(lambda z: log(_rate(z, tau) / wanted), 1.0, 37.0))
