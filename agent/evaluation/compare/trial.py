"""One recording, and what every method is given of it; how well an estimate predicts an unseen window."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agent.blocks.rig_model import SENSOR_KINDS, RigModel, hop_plan, rig_model, scale_columns, windows_s
from agent.commissioning.explained import free_run
from agent.commissioning.readings import Recorded
from agent.config import RigConfig
from agent.errors import RecordingError
from agent.evaluation.tuning import (
    FASTER_POLE,
    LEAST_WINDOWS,
    MOST_COMPARED,
    MOST_SCORED,
    MOST_TUNED,
    TUNED_PARTS,
)
from agent.numerics.inference.tuning import DIGITS
from agent.numerics.model.holds import straight
from agent.numerics.model.sensors import with_constant
from agent.numerics.model.statespace import Hold, discretise
from agent.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Estimates:
    """Rows of one run.

    Attributes:
        index: (R,) newest sample of each row.
        theta, sd: (R, q) estimates and their standard deviations, NaN where a method states none.
        lower, upper: (R, q) 95 % intervals, NaN likewise.
        valid: (R, q) what the method itself is sure of.
        microseconds: processor time a sample.
    """

    index: IntArray
    theta: FloatArray
    sd: FloatArray
    lower: FloatArray
    upper: FloatArray
    valid: BoolArray
    microseconds: float

    def known(self, sample: int, nominal: FloatArray) -> FloatArray:
        """Return (q,) the newest valid estimates at the end of a sample, nominal before the first."""
        theta = nominal.copy()
        before = self.index <= sample
        for column in range(len(theta)):
            rows = np.flatnonzero(before & self.valid[:, column] & np.isfinite(self.theta[:, column]))
            theta[column] = self.theta[rows[-1], column] if len(rows) else theta[column]
        return theta


@dataclass(frozen=True, eq=False)
class Trial:
    """What is compared over.

    Attributes:
        config, rig: of the machine.
        y, u: (N, p), (N, m) the recording's longest piece in SI, the constant input appended where the model
            has one.
        noise: (p,) of the outputs' sensors.
        window: samples that are predicted at a time.
        size: (q,) what changes of the parameters are counted in.
    """

    config: RigConfig
    rig: RigModel
    y: FloatArray
    u: FloatArray
    noise: FloatArray
    window: int
    size: FloatArray

    @property
    def nominal(self) -> FloatArray:
        """(q,) where every method begins."""
        return np.asarray(self.rig.model.nominal, dtype=float)

    @property
    def period_s(self) -> float:
        """Between samples, s."""
        return 1.0 / self.config.rig.sample_rate_hz

    @property
    def hold(self) -> Hold:
        """What the inputs do between samples; polynomials are straight lines here."""
        return straight(self.config.estimator.hold)

    @property
    def tuning(self) -> slice:
        """The samples that methods are tuned on."""
        return slice(0, min(len(self.y) // TUNED_PARTS, MOST_TUNED))

    def scored(self, part: slice | None = None) -> list[int]:
        """Return where windows begin that are predicted from the past: after the tuning, or in a part."""
        first, end = (len(self.y) // TUNED_PARTS, len(self.y)) if part is None else (part.start, part.stop)
        starts = np.arange(max(first, self.window), end - self.window + 1, self.window)
        chosen = np.unique(np.linspace(0, len(starts) - 1, min(len(starts), MOST_SCORED)).round().astype(int))
        return [int(starts[i]) for i in chosen.tolist()] if len(starts) else []

    def left(self, found: Estimates, starts: Sequence[int]) -> FloatArray:
        """Return (p,) the mean square predictions leave, in units of the sensors' noise, over windows."""
        squares = [self._left(found.known(start - 1, self.nominal), start) for start in starts]
        return np.asarray(np.mean(squares, axis=0))

    def motion(self, starts: Sequence[int]) -> FloatArray:
        """Return (p,) the mean square of the motion about each window's mean, in the same units."""
        return np.asarray(np.mean([self._motion(start) for start in starts], axis=0))

    def _motion(self, start: int) -> FloatArray:
        y = self.y[start : start + self.window]
        return np.asarray(np.mean((y - y.mean(axis=0)) ** 2, axis=0) / self.noise**2)

    def _left(self, theta: FloatArray, start: int) -> FloatArray:
        """What a free run at theta leaves of a window; what predicts worse than nothing explains nothing."""
        rows = slice(start, start + self.window)
        y = self.y[rows]
        motion = self._motion(start)
        continuous = self.rig.model.continuous(theta)
        fastest = float(np.abs(np.linalg.eigvals(self.rig.model.continuous(self.nominal).A)).max())
        eigenvalues = np.linalg.eigvals(continuous.A)
        grown = eigenvalues.real.max() * self.window * self.period_s
        if not np.all(np.isfinite(theta)) or np.abs(eigenvalues).max() > FASTER_POLE * fastest or grown > 20:
            return np.asarray(motion)
        left = (y - free_run(discretise(continuous, self.period_s, self.hold), y, self.u[rows])) / self.noise
        return np.asarray(np.minimum(np.nan_to_num(np.mean(left**2, axis=0), nan=np.inf), motion))


def trial_of(config: RigConfig, recorded: Recorded) -> Trial:
    """Return what is compared over: the longest piece of a recording. Raises RecordingError if too short."""
    rig = rig_model(config)
    first, end = max(recorded.pieces, key=lambda piece: piece[1] - piece[0])
    end = min(end, first + MOST_COMPARED)
    y = recorded.y[first:end]
    u = with_constant(recorded.u[first:end], _inputs(rig))
    longest = round(windows_s(config)[-1] * config.rig.sample_rate_hz)
    window = max(hop_plan(config).window, min(longest, len(y) // (4 * LEAST_WINDOWS)))
    if len(y) < LEAST_WINDOWS * window:
        what = f"its longest piece of {len(y)} samples holds fewer than {LEAST_WINDOWS} windows of {window}"
        raise RecordingError.at(
            recorded.name, what, "give a longer recording, or a shorter estimator.window_s"
        )
    stated = np.array([(c.noise_sd or 0.0) * c.si_factor for c in config.outputs])
    seen = np.where(recorded.noise > 0, recorded.noise, stated)
    noise = np.maximum(seen, np.maximum(DIGITS * y.std(axis=0), 1e-300))
    return Trial(config, rig, y, u, noise, window, _sizes(config, rig, y, u))


def _inputs(rig: RigModel) -> int:
    return rig.model.continuous(np.asarray(rig.model.nominal, dtype=float)).m


def _sizes(config: RigConfig, rig: RigModel, y: FloatArray, u: FloatArray) -> FloatArray:
    nominal = np.abs(np.asarray(rig.model.nominal, dtype=float))
    levels = np.sqrt(np.mean(np.hstack([y, u]) ** 2, axis=0))[scale_columns(config, rig)]
    is_offset = np.array([p.kind in SENSOR_KINDS and p.nominal == 0 for p in rig.parameters])
    return np.where(is_offset, levels, np.where(nominal > 0, nominal, 1.0))
