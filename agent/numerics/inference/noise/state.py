"""Noise of a rig as known after some windows: sensors' sd, levels of bins, intensities of sources."""

from dataclasses import dataclass, replace

import numpy as np

from agent.numerics.inference import tuning
from agent.numerics.inference.noise.rounding import Rounding, rounding_after
from agent.numerics.inference.spectral.algebra import inverse
from agent.numerics.inference.spectral.sources import Source
from agent.numerics.preprocessing.wire import Wire
from agent.types import BoolArray, ComplexArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Places:
    """Where lines stand between bins, each by least squares over windows.

    About a line at f the spectrum R runs as 1 / (f − k), so f − k = n / d with n = R(k−1) − R(k+1) and
    d = 2 R(k) − R(k−1) − R(k+1) (Jacobsen & Kootsookos, IEEE Signal Processing Magazine 24 (3) (2007) 123).

    Attributes:
        along, squares: (K, p) sums of Re n d* and of |d|², old windows forgotten.
    """

    along: FloatArray
    squares: FloatArray

    @classmethod
    def unseen(cls, bins: int, outputs: int) -> "Places":
        """Return what is known before any window."""
        return cls(np.zeros((bins, outputs)), np.zeros((bins, outputs)))

    def after(self, residual: ComplexArray, bin_of: IntArray) -> "Places":
        """Return the places after one more window's residual (b, p) on bins (b,)."""
        n = residual[:-2] - residual[2:]
        d = 2 * residual[1:-1] - residual[:-2] - residual[2:]
        # of high bins only an even spread may be at hand
        next_to = np.flatnonzero(bin_of[2:] - bin_of[:-2] == 2)
        along, squares = tuning.FORGET * self.along, tuning.FORGET * self.squares
        along[bin_of[1 + next_to]] += (n * d.conj()).real[next_to]
        squares[bin_of[1 + next_to]] += (np.abs(d) ** 2)[next_to]
        return Places(along, squares)

    @property
    def off(self) -> FloatArray:
        """(K, p) place of a line from the middle of its bin (-½ .. ½); 0 where no window was seen."""
        return np.clip(self.along / np.where(self.squares > 0, self.squares, 1.0), -0.5, 0.5)


@dataclass(frozen=True, slots=True)
class Noise:
    """What is known of a rig's noise; frozen, a new one after every window learnt.

    Attributes:
        log_sigma, log_sigma_var: (p,) log of each sensor's sd and its variance.
        power, dof: (K, p), (K, p) scaled inverse χ² of each bin's level: Σ normalised power, degrees of
            freedom.
        nodes, log_weight: (a, G) intensities of each source and their log-weights; empty before the first
            window.
        intensity: (a,) posterior mean of each.
        spread: (a, q) relative variance that the uncertainty of each intensity adds to each parameter.
        places: where lines are.
        windows: windows learnt; turn: whose turn it is in the rotation.
        walk: variance of the random walk of log σ from window to window; counted: windows behind it.
        information: (a, a) of the variances of sources that are there, from all windows, old ones forgotten;
            0 for the others; None where there are none.
        rounding: what it adds to σ²; None where it is the same for all readings: σ then has it in.
    """

    log_sigma: FloatArray
    log_sigma_var: FloatArray
    power: FloatArray
    dof: FloatArray
    nodes: FloatArray
    log_weight: FloatArray
    intensity: FloatArray
    spread: FloatArray
    places: Places
    windows: int = 0
    turn: int = 0
    walk: float = tuning.SIGMA_WALK**2
    counted: float = tuning.SIGMA_WALK_DOF
    information: FloatArray | None = None
    rounding: Rounding | None = None

    @classmethod
    def prior(cls, sigma: FloatArray, spread: FloatArray, bins: int, sources: int, q: int) -> "Noise":
        """Return what is known before the first window; sigma (p,), spread (p,) sd of its logarithm."""
        p = len(sigma)
        counted = np.full((bins, p), tuning.LEVEL_DOF)
        empty = np.zeros((sources, 0))
        return cls(
            np.log(sigma),
            spread**2,
            counted,
            counted.copy(),
            empty,
            empty,
            np.zeros(sources),
            np.zeros((sources, q)),
            Places.unseen(bins, p),
        )

    @property
    def levels(self) -> FloatArray:
        """(K, p) level of each bin."""
        return self.power / self.dof

    @property
    def unsure(self) -> float:
        """Variance of the logarithm of white noise's sd, of the sensor known least, in the window to come."""
        own = (np.exp(self.log_sigma) / self.sd) ** 2
        return float((own**2 * self.log_sigma_var).max()) + float((own**2).max()) * self.walk

    @property
    def sd(self) -> FloatArray:
        """(p,) sd of each output's white noise: the sensor's own and the rounding's."""
        return np.exp(self.log_sigma) if self.rounding is None else np.sqrt(self.white)

    @property
    def white(self) -> FloatArray:
        """(p,) its variance."""
        own = np.exp(2 * self.log_sigma)
        return own if self.rounding is None else own + self.rounding.usual

    def of(self, y: FloatArray) -> "Noise":
        """Return the noise of a window of readings y (W, p), which are rounded as they are."""
        return self if self.rounding is None else replace(self, rounding=self.rounding.at(y))

    def met(self, y: FloatArray, wire: Wire) -> "Noise":
        """Return the noise with the rounding that one more window of values y (W, p) shows."""
        return replace(self, rounding=rounding_after(self.rounding, y, wire))

    def differs_from(self, before: "Noise", sources: tuple[Source, ...]) -> bool:
        """Whether an intensity that is large moved by more than a share since an earlier window.

        What is sought together trades among the colours of a force or sensor: there the whole counts.
        """
        if not before.is_started:
            return True
        # what may as well be absent has a mean that moves by chance
        there = (before.intensity > tuning.LARGE_NODES * before.nodes[:, 0]) & (
            before.log_weight[:, 0] < -tuning.SURE
        )
        together = self.there(sources)
        there[together] = False
        moved = np.abs(np.log(self.intensity[there] / before.intensity[there]))
        now = by_origin(self.intensity**2, together, sources)
        then = by_origin(before.intensity**2, together, sources)
        wholes = [abs(np.log(now[origin] / then[origin])) / 2 for origin in now]
        return bool((moved > tuning.UNSETTLED).any() or max(wholes, default=0.0) > tuning.UNSETTLED)

    def exceeds(self, before: "Noise") -> bool:
        """Whether the noise has grown: an intensity that doubled, or a sensor's sd a tenth larger."""
        there = np.maximum(2 * before.intensity, tuning.ACTIVE_NODES * self.nodes[:, 0])
        return bool((self.intensity > there).any() or (self.log_sigma > before.log_sigma + 0.1).any())

    def is_other_than(self, before: "Noise") -> bool:
        """Whether there is more or less noise than before, as in `exceeds`."""
        return not before.is_started or self.exceeds(before) or before.exceeds(self)

    @property
    def shows_colours(self) -> bool:
        """Whether a window is long enough to show the slowest colour.

        In shorter ones what a model lacks passes for colours, and forces with them.
        """
        return min(tuning.SENSOR_CORNERS) * 2 * (len(self.power) - 1) >= tuning.SHOWN_PERIODS

    @property
    def loud(self) -> BoolArray:
        """(a,) sources that show beside the sensors' white noise."""
        least = tuning.ACTIVE_NODES * self.nodes[:, 0] if self.is_started else np.inf
        return np.asarray(self.intensity > least)

    def lasting(self, sources: tuple[Source, ...]) -> tuple[int, ...]:
        """Return the sources whose work at a window's ends counts: slow forces, and colours that show."""
        loud = self.loud & self.shows_colours
        return tuple(
            a for a, source in enumerate(sources) if source.is_slow_force or (source.is_colour and loud[a])
        )

    def there(self, sources: tuple[Source, ...]) -> IntArray:
        """Return the sources of forces and sensors of which one source is there for sure."""
        if not self.is_started or not self.shows_colours:
            return np.zeros(0, dtype=np.int64)
        sure = self.loud & (self.log_weight[:, 0] < -tuning.SURE)
        origins = {sources[a].origin for a in np.flatnonzero(sure)}
        return np.array([a for a, source in enumerate(sources) if source.origin in origins], dtype=np.int64)

    def firmness(self, there: IntArray, sources: tuple[Source, ...]) -> FloatArray:
        """Return the precision (t, t) of the variances of sources that are there, by windows before.

        They walk as σ does, in units of the whole of their origin; what is new may be as large as that.
        """
        whole = by_origin(self.intensity**2, there, sources)
        size = np.array([whole[sources[a].origin] for a in there.tolist()])
        out = np.diag(size**-2.0)
        if self.information is not None:
            old = np.flatnonzero(np.diag(self.information)[there] > 0)
            carried = inverse(self.information[np.ix_(there[old], there[old])])
            out[np.ix_(old, old)] = inverse(carried + np.diag(4 * self.walk * size[old] ** 2))
        return out

    @property
    def is_started(self) -> bool:
        """Whether the grids of intensities stand."""
        return bool(self.nodes.size)


def by_origin(
    variance: FloatArray, which: IntArray, sources: tuple[Source, ...]
) -> dict[tuple[str, int], float]:
    """Return the sum of variances (a,) of some sources, of each force and sensor."""
    out: dict[tuple[str, int], float] = {}
    for a in which.tolist():
        out[sources[a].origin] = out.get(sources[a].origin, 0.0) + float(variance[a])
    return out


def chance(dof: FloatArray | float, unsure: float) -> FloatArray:
    """Return the predictive sd of the logarithm of a residual's power, with variance `unsure` of log σ."""
    return np.asarray(np.sqrt(2 / dof + 4 * unsure))


def louder(power: FloatArray | float, dof: FloatArray | float, unsure: float) -> FloatArray:
    """Return by how much the noise of a window exceeds what was expected, from its residual's power over dof.

    As much of that is the window's own σ as the walk of σ allows for; less power than expected is no luck.
    """
    return np.asarray(np.maximum(power, 1.0) ** (4 * unsure / (4 * unsure + 2 / dof)))
