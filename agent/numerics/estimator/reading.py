"""Rows from the bank's normal equations: posterior of the parameters, and the two tests of every window."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from agent.numerics.estimator.doubts import Found
from agent.numerics.estimator.operating_point import OperatingPoint
from agent.numerics.estimator.tuning import (
    EVEN,
    FAR_CURVATURE,
    FAR_SD,
    FAR_SHARPEST,
    FARTHEST_SD,
    FLAT,
    POORER,
)
from agent.numerics.inference.mixture import NORMAL_975
from agent.numerics.inference.noise.rounding import RoundingErrors
from agent.numerics.inference.noise.state import chance, louder
from agent.numerics.inference.scatter import widened
from agent.numerics.inference.tuning import MISMATCH_SD
from agent.numerics.window.rows import Windowed
from agent.numerics.window.solve import Normal, inverse
from agent.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Reading:
    """What N windows of one length say.

    Attributes:
        index: (N,) newest sample.
        theta, sd, lower, upper, sd_repeat: (N, q).
        jump: (N,) largest statistic of a jump; 0 where none is tested.
        excess: (N,) misfit in predictive standard deviations.
        far: (N,) linearised too far away for its sharpness.
        dof: (N,) degrees of freedom.
        samples: length of the window.
        unsolved: (N,) windows that lost too many readings.
        found: what windows, by their newest samples, say of suspect readings.
    """

    index: IntArray
    theta: FloatArray
    sd: FloatArray
    lower: FloatArray
    upper: FloatArray
    sd_repeat: FloatArray
    jump: FloatArray
    excess: FloatArray
    far: BoolArray
    dof: FloatArray
    samples: int
    unsolved: BoolArray
    found: Mapping[int, Found]

    def broken(self, threshold: float) -> BoolArray:
        """(N,) windows that hold a change, or that nothing known explains."""
        return np.asarray(
            (self.jump > threshold) | (self.excess > MISMATCH_SD) | ~np.isfinite(self.sd).all(axis=1)
        )


def read(
    windowed: Windowed, point: OperatingPoint, samples: int, repeats: FloatArray | float = 1.0,
    uneven: RoundingErrors | None = None, jump_before: float = 0.0, far_sd: float = FAR_SD,
) -> Reading:  # fmt: skip
    """Return what windows of a length say, constants and intensities as known at the operating point.

    repeats: (N,) factor on the variance, by readings that repeat one code. uneven: noise of their readings,
    where it is not the same for all. jump_before: the newest statistic
    of a jump before these rows, which stands until the next row that is scanned. far_sd: sds from the point
    beyond which a window is linearised too far away.
    """
    q = len(point.theta)
    d, covariance, own, by_constants = solved(windowed.normal, point.along, point.unseen)
    # sums of each row by itself: a product of all rows has other last bits where they come otherwise
    moved = d[:, :q] + (d[:, None, q:] * point.along).sum(axis=2)
    own = np.where(own > 0, own, np.nan)  # a variance without digits: the row counts as broken
    by_constants = point.unit * by_constants
    theta = point.theta + point.unit * moved
    again = np.reshape(repeats, (-1, 1))
    sharp = np.sqrt(again * own)
    # the point was found by sharper windows: a poor one moves it only by what chance never does
    least = np.where(sharp > POORER * point.sharpest, FARTHEST_SD, far_sd)
    # by as much as constants leave open in a window its estimate may differ from that of any other
    spread = np.hypot(sharp, by_constants / point.unit)
    far = np.abs(moved) > np.maximum(least * spread, np.sqrt(FAR_CURVATURE * sharp))
    far = (far & (sharp < FAR_SHARPEST)).any(axis=1)
    rss = np.maximum(windowed.normal.rss - np.einsum("ni,ni->n", windowed.normal.g, d), 1e-300)
    dof: FloatArray = float(samples * len(point.model.C) - point.model.n - q) - windowed.lost.astype(float)
    stop = windowed.index + 1
    power = rss / dof
    alike = dof
    inflation = np.ones(1)
    if uneven is not None:
        power = power / uneven.power(stop - samples, stop)
        alike = dof * uneven.count(stop - samples, stop) / samples
        inflation = uneven.inflation(stop - samples, stop)
    excess = np.log(power) / chance(alike, point.unsure)
    own_wider = own * widened(inflation[:, None] * point.wider, again)
    own_wider = own_wider * louder(power, alike, point.unsure)[:, None]
    # a row that is far from the point carries the term of second order that it neglects, until it is solved
    neglected = np.where(far[:, None], moved**2, 0.0)
    repeat = np.hypot(point.unit * np.hypot(np.sqrt(own_wider), neglected), point.slid)
    shape = point.shape
    half = NORMAL_975 * np.sqrt(repeat**2 + (shape.share * by_constants) ** 2) + shape.apart * by_constants
    width = half / NORMAL_975
    jump = _jumps(windowed, d, covariance, power, point, uneven, samples, jump_before)
    centre = theta + shape.centre * by_constants
    even = np.abs(shape.centre - shape.mean) * by_constants < EVEN * width
    centre = np.where(even, theta + shape.mean * by_constants, centre)
    return Reading(
        windowed.index, theta + shape.mean * by_constants, width, centre - half, centre + half, repeat, jump,
        excess,
        far, dof, samples, windowed.unsolved, _found(windowed, d, covariance),
    )  # fmt: skip


def solved(
    normal: Normal, along: FloatArray, unseen: FloatArray | float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Deviations (N, q+c), their covariance, and variance and sd (N, q) of θ by readings and by constants.

    along: (q, c) by how much constants of unit prior move the parameters beside what their columns do;
    unseen: (q,) variance by those that have no column. The
    parameters are eliminated first: by how much constants that no window shows move them is then no small
    difference of numbers that grow with the readings' precision.
    """
    q = len(along)
    own, others = normal.equations[:, :q], normal.equations[:, q:]
    given = inverse(own[:, :, 1 : 1 + q] + FLAT * np.eye(q))
    alone = given @ own  # of the parameters' g, of their H, and of theirs with the constants: side by side
    left = others - others[:, :, 1 : 1 + q] @ alone
    moved = -alone[:, :, 1 + q :]
    precision = left[:, :, 1 + q :]
    constants = inverse(0.5 * (precision + precision.transpose(0, 2, 1)) + np.eye(len(others[0])))
    found = constants @ left[:, :, :1]
    across = moved @ constants
    own = given + across @ moved.transpose(0, 2, 1)
    covariance = np.empty((len(given), q + len(found[0]), q + len(found[0])))
    covariance[:, :q, :q] = own
    covariance[:, :q, q:] = across
    covariance[:, q:, :q] = across.transpose(0, 2, 1)
    covariance[:, q:, q:] = constants
    d = np.concatenate([alone[:, :, :1] + moved @ found, found], axis=1)[:, :, 0]
    whole = moved + along
    variance = ((whole @ constants) * whole).sum(axis=2) + unseen
    return d, covariance, given.diagonal(axis1=1, axis2=2), np.sqrt(np.maximum(variance, 0.0))


def _jumps(
    windowed: Windowed, d: FloatArray, covariance: FloatArray, power: FloatArray, point: OperatingPoint,
    uneven: RoundingErrors | None, samples: int, before: float,
) -> FloatArray:  # fmt: skip
    """(N,) largest statistics of jumps; a row that is not scanned shows what the newest before it did."""
    if windowed.jumps is None or not len(windowed.jumps.index):
        return np.full(len(power), before)
    at = np.searchsorted(windowed.index, windowed.jumps.index)
    each = windowed.jumps.glr(d[at], covariance[at])
    if uneven is not None:
        end = windowed.index[at][:, None] + 1
        each = each / uneven.jump(end - samples, end - np.array(windowed.jumps.samples), end)
    # which jump a drift inside this window looks like is not known: it may be the one that is found
    found = each.max(axis=1, initial=0.0) / (np.maximum(1.0, power[at]) * point.scatter * (1 + point.slide))
    place = np.searchsorted(at, np.arange(len(power)), side="right") - 1
    return np.where(place >= 0, found[np.maximum(place, 0)], before)


def _found(windowed: Windowed, d: FloatArray, covariance: FloatArray) -> dict[int, Found]:
    """Return what windows say of the readings that they were asked about."""
    answers: dict[int, Found] = {}
    for asked in windowed.asked:
        i = int(np.searchsorted(windowed.index, asked.index))
        places = zip(asked.sample.tolist(), asked.channel.tolist(), strict=True)
        spread = asked.covariance + asked.slope @ covariance[i] @ asked.slope.T
        answers[asked.index] = Found(tuple(places), asked.value + asked.slope @ d[i], spread, asked.sd)
    return answers
