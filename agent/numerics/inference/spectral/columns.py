"""A window as linear regression: [Γ | τ | lost | Ψ | Ξ | jumps | r] on kept bins, and the residual above."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from agent.numerics.inference.spectral.algebra import inverse
from agent.numerics.inference.spectral.bins import unitary
from agent.numerics.inference.spectral.response import Response, end_states
from agent.numerics.inference.spectral.sources import Source, end_effects
from agent.numerics.model.uncertain import CURVED, LAG, Constant, Rig, columns_of, gains_of
from agent.types import ComplexArray, FloatArray, IntArray

Weigh = Callable[[ComplexArray], FloatArray]
"""The Gram (c, c) of columns (kept, p, c) under today's noise."""


@dataclass(frozen=True, slots=True)
class Window:
    """The samples of one window.

    Attributes:
        y: (W, p) outputs, lost readings filled in.
        u: (W, m) inputs.
        slope: (W, m) change of each input since the sample before, by which inputs are late.
        lost: (l, 2) row and channel (outputs, then inputs) of readings that were filled in.
        lost_sd: (l,) prior sd of what the fill-in is wrong by; inf for outputs (the reading counts for
            nothing).
    """

    y: FloatArray
    u: FloatArray
    slope: FloatArray
    lost: IntArray
    lost_sd: FloatArray

    @property
    def length(self) -> int:
        """W."""
        return len(self.y)


def window_of(y: FloatArray, u: FloatArray, before: FloatArray | None = None) -> Window:
    """Return a whole window without lost readings; before (m,): inputs one sample earlier, where known."""
    first = u[:1] if before is None else before[None]
    slope = np.diff(u, axis=0, prepend=first)
    return Window(y, u, slope, np.zeros((0, 2), dtype=np.int64), np.zeros(0))


def refilled(window: Window, change: FloatArray, rig: Rig) -> Window:
    """Return a window whose lost inputs are filled with `change` (l,) more than before, at every tap."""
    u = window.u.copy()
    slope = window.slope.copy()
    p = window.y.shape[1]
    for (row, channel), more in zip(window.lost.tolist(), change.tolist(), strict=True):
        if channel < p:
            continue
        for shift, column in zip((0, *rig.shifts), rig.taps_of(channel - p).tolist(), strict=False):
            if 0 <= row - shift < window.length:
                u[row - shift, column] += more
                slope[row - shift : row - shift + 2, column] += np.array([more, -more])[
                    : window.length - row + shift
                ]
    return replace(window, u=u, slope=slope)


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the columns of each kind stand.

    Attributes:
        n: initial states, the last `free` of them momenta of free masses; lasting: sources with an end
            effect; lost: lost readings;
        q: parameters; constants: of the rig; cuts: jumps.
    """

    n: int
    free: int
    lasting: tuple[int, ...]
    lost: int
    q: int
    constants: int
    cuts: int

    @property
    def base(self) -> int:
        """Columns without the jumps and the residual."""
        return self.n + len(self.lasting) + self.lost + self.q + self.constants

    @property
    def nuisance(self) -> slice:
        """Everything before the parameters."""
        return slice(0, self.n + len(self.lasting) + self.lost)

    @property
    def ends(self) -> slice:
        """What unknown forces and coloured noise do at the window's ends."""
        return slice(self.n - self.free, self.n + len(self.lasting))

    @property
    def gaps(self) -> slice:
        """The lost readings."""
        start = self.n + len(self.lasting)
        return slice(start, start + self.lost)

    @property
    def psi(self) -> slice:
        """The parameters of interest."""
        start = self.nuisance.stop
        return slice(start, start + self.q)

    @property
    def xi(self) -> slice:
        """The constants of the rig."""
        return slice(self.psi.stop, self.base)

    def jump(self, i: int) -> slice:
        """A jump of the parameters at cut i."""
        return slice(self.base + i * self.q, self.base + (i + 1) * self.q)


@dataclass(frozen=True, slots=True)
class Regression:
    """The columns of a window, linearised at the point and the window's own best initial state.

    Attributes:
        X: (kept, p, base + jumps + 1) columns; the last is the residual.
        high: (h, p) residual on the high bins.
        states: (kept, n) the trajectory.
        driven: (kept + h, p) power of the modelled readings.
        layout: where the columns stand.
    """

    X: ComplexArray
    high: ComplexArray
    states: ComplexArray
    driven: FloatArray
    layout: Layout

    @property
    def without_jumps(self) -> ComplexArray:
        """The base columns and the residual."""
        if not self.layout.cuts:
            return self.X
        return np.concatenate([self.X[..., : self.layout.base], self.X[..., -1:]], axis=2)


class Regressor:
    """Builds the regression of windows of one rig at one response and one set of constants.

    Args:
        rig, response, sources: what is modelled.
        eta: (c,) deviations of the constants at which the model stands; masses and the delay are in the
            response already.
        stretch: (s,) mean squares of extension at which springs' cubes are shares of their stiffness, m².
        lasting: numbers of the sources that get a column for the window's ends.
    """

    def __init__(
        self,
        rig: Rig,
        response: Response,
        sources: tuple[Source, ...],
        eta: FloatArray,
        lasting: tuple[int, ...] = (),
        stretch: FloatArray | None = None,
    ) -> None:
        self.rig, self.response, self.lasting = rig, response, lasting
        self._ending = [sources[a] for a in lasting]
        self.output_gain, self.input_gain = gains_of(rig, eta, response.at, stretch)
        self._stretch = np.ones(len(rig.cubics)) if stretch is None else stretch

    def inputs(self, window: Window) -> FloatArray:
        """Return the inputs (W, m) with gains put right; beside them their slopes, where they may be late."""
        late = self.response.at.late is not None
        return np.asarray(self.input_gain * (np.hstack([window.u, window.slope]) if late else window.u))

    def layout(self, window: Window, cuts: int) -> Layout:
        """Return where the columns stand."""
        rig = self.rig
        free, constants = len(self.response.left), len(rig.constants)
        return Layout(self.response.at.n, free, self.lasting, len(window.lost), rig.q, constants, cuts)

    def build(
        self,
        window: Window,
        weigh: Weigh,
        cuts: IntArray,
        driven: Callable[[ComplexArray], ComplexArray] | None = None,
        whole: bool = True,
        joint: bool = False,
    ) -> Regression:
        """Return the regression; `weigh` gives the columns' Gram under today's noise, for the initial state.

        driven: takes readings (kept, p) to the states (kept, n) that unknown forces drive. The initial state
        of the periodic response is e0; the state that the window began with is e0 and what those forces had
        driven by then. whole: with the high bins; a trial of a step asks for none of them. joint: columns are
        of the motion that those forces make too, as where parameters and forces are sought together.
        """
        response, at, bins = self.response, self.response.at, self.response.bins
        u = self.inputs(window)
        fu, fy = unitary(u), unitary(window.y)
        edges = np.concatenate([[0], cuts, [bins.window]]).astype(np.int64)
        forced = self._forced(u, edges)
        low = fu[: bins.kept]
        X = np.einsum("kij,kj->ki", response.RB, low) - response.zR @ forced[-1]
        gamma: ComplexArray = np.asarray(response.gamma * self.output_gain[:, None], dtype=complex)
        residual = fy[: bins.kept] - self._outputs(X, low)
        x0 = self._best_start(weigh, gamma, residual)
        periodic = x0
        sums = np.zeros((len(edges), at.n))
        if response.is_free:
            x0, sums = self._placed(x0, u, fy[0].real, fu[0].real, edges)
        elif driven is not None:
            left = residual - ((response.free @ x0) @ at.C.T) * self.output_gain
            states = driven(left)
            x0 = x0 + (states.real * response.bins.multiplicity[: bins.kept, None]).sum(axis=0) / np.sqrt(
                bins.window
            )
        X = X + response.free @ x0
        if response.is_free:
            X[0] = sums[-1] / np.sqrt(bins.window)
        modelled = self._outputs(X, low)
        residual = fy[: bins.kept] - modelled
        moved = X + driven(residual) if joint and driven is not None else X
        ends = end_effects(response, self._ending, self.output_gain)
        parts = [gamma, ends, self._lost(window), *self._parameters(moved, low)]
        parts.append(self._constants(window, self._outputs(moved, low), moved, low))
        parts += self._jumps(u, x0, forced, edges, sums)
        parts.append(residual[..., None])
        X_all = np.concatenate(parts, axis=2)
        above = high = np.zeros((0, len(self.output_gain)), dtype=complex)
        if whole:
            above = self._high(fu, x0 if response.is_free else periodic, forced[-1])
            high = fy[bins.high] - above
        power = np.abs(np.vstack([modelled, above])) ** 2
        return Regression(X_all, high, X, power, self.layout(window, len(cuts)))

    def slide(self, window: Window, constant: Constant) -> ComplexArray:
        """Return what a gain that grows by 1 evenly through a window does (kept, p): 0 at the middle."""
        kept, W = self.response.bins.kept, window.length
        growth = ((np.arange(W) + 0.5) / W - 0.5)[:, None]
        out = np.zeros((kept, len(self.output_gain)), dtype=complex)
        if constant.kind == "output":
            out[:, constant.number] = unitary(growth * window.y)[:kept, constant.number]
        elif constant.kind == "input":
            grown = unitary(growth * self.inputs(window))[:kept]
            taps = columns_of(self.rig, constant.number, self.response.at).tolist()
            out = np.sum([self.response.driven(j, grown[:, j]) for j in taps], axis=0) * self.output_gain
        return out

    def _outputs(self, X: ComplexArray, U: ComplexArray) -> ComplexArray:
        at = self.response.at
        return np.asarray((X @ at.C.T + U @ at.D.T) * self.output_gain)

    def _best_start(self, weigh: Weigh, gamma: ComplexArray, residual: ComplexArray) -> FloatArray:
        """Initial state (n,) best explaining the residual (Golub & Pereyra, SIAM J. Num. Anal. 10, 1973)."""
        response = self.response
        n = response.starts.shape[1]
        G = weigh(np.concatenate([gamma[..., :n], residual[..., None]], axis=2))
        return np.asarray(response.starts @ (inverse(G[:n, :n]) @ G[:n, n] / response.gamma_scale[:n]))

    def _placed(
        self, x0: FloatArray, u: FloatArray, y_mean: FloatArray, u_mean: FloatArray, edges: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """The initial state with free masses that bin 0 shows, and sums (len(edges), n) of earlier states."""
        at, W, n = self.response.at, self.response.bins.window, self.response.at.n
        # the state beside its running sum
        A = np.block([[at.A, np.zeros((n, n))], [np.eye(n), np.eye(n)]])
        power = partial(np.linalg.matrix_power, A)
        forced = _edge_states(A, np.pad(u @ at.B.T, ((0, 0), (0, n))), edges, power)[:, n:]
        powers = np.array([power(edge)[n:, :n] for edge in edges.tolist()])
        sums = forced + powers @ x0
        wanted = y_mean / self.output_gain - at.C @ sums[-1] / np.sqrt(W) - at.D @ u_mean
        still = self.response.still
        shift = np.linalg.lstsq(at.C @ powers[-1] @ still / np.sqrt(W), wanted, rcond=None)[0]
        return x0 + still @ shift, sums + powers @ (still @ shift)

    def _forced(self, u: FloatArray, edges: IntArray) -> FloatArray:
        """(len(edges), n) states at the edges when started from zero."""
        at = self.response.at
        return _edge_states(at.A, u @ at.B.T, edges, self.response.power)

    def _lost(self, window: Window) -> ComplexArray:
        """One column a lost reading: an error of 1 in what was filled in."""
        kept = self.response.bins.kept
        p = len(self.output_gain)
        W = window.length
        out = np.zeros((kept, p, len(window.lost)), dtype=complex)
        k = np.arange(kept)
        for column, (row, channel) in enumerate(window.lost):
            impulse = np.exp(-2j * np.pi * k * row / W) / np.sqrt(W)
            if channel < p:
                out[:, channel, column] = impulse
            else:
                out[:, :, column] = self._impulse(int(row), int(channel) - p, W) * self.output_gain
        return out

    def _impulse(self, row: int, number: int, length: int) -> ComplexArray:
        """Return the response (kept, p) to 1 more in one reading of a measured input, at all its taps."""
        k = np.arange(self.response.bins.kept)
        out = np.zeros((len(k), len(self.output_gain)), dtype=complex)
        # an input that no channel drives has one tap
        for shift, column in zip((0, *self.rig.shifts), self.rig.taps_of(number).tolist(), strict=False):
            if 0 <= row - shift < length:
                signal = np.exp(-2j * np.pi * k * (row - shift) / length) / np.sqrt(length)
                out += self.response.driven(column, signal)
        return out

    def _parameters(self, X: ComplexArray, U: ComplexArray) -> list[ComplexArray]:
        columns = self.response.columns(X[:, None], U[:, None]) * self.output_gain[:, None]
        return [columns[..., : self.rig.q], columns[..., self.rig.q :]]

    def _constants(
        self, window: Window, modelled: ComplexArray, X: ComplexArray, U: ComplexArray
    ) -> ComplexArray:
        """Columns of gains, delays and cubes, in the order of the rig's constants after the masses."""
        kept, p = modelled.shape
        rig = self.rig
        columns = []
        for constant in rig.constants[rig.masses :]:
            column = np.zeros((kept, p), dtype=complex)
            if constant.kind == "output":
                column[:, constant.number] = modelled[:, constant.number]
            elif constant.kind in ("input", "cubic"):
                column = self._pushing(constant, window, U)
            elif (curve := self.response.at.curve) is not None and constant.number == CURVED:
                column = np.hstack([X, U]) @ curve.T * self.output_gain
            elif (lag := self.response.at.lag) is not None and constant.is_lag:
                own = constant.number - LAG
                column[:, own] = np.hstack([X, U]) @ lag[own] * self.output_gain[own]
            elif (late := self.response.at.late) is not None:
                slopes = U[:, len(rig.measured) :]
                column = self.response.delayed(late[constant.number], slopes) * self.output_gain
            columns.append(column)
        return np.stack(columns, axis=2) if columns else np.zeros((kept, p, 0), dtype=complex)

    def _pushing(self, constant: Constant, window: Window, U: ComplexArray) -> ComplexArray:
        """Return what a measured input does (kept, p), or a spring's cube, whose gain may be 0 in U."""
        if constant.kind == "input":
            taps = columns_of(self.rig, constant.number, self.response.at).tolist()
            return np.asarray(
                np.sum([self.response.driven(j, U[:, j]) for j in taps], axis=0) * self.output_gain
            )
        j = self.rig.cubic_input(constant.number)
        cube = unitary(window.u[:, j] / self._stretch[constant.number])[: len(U)]
        return self.response.driven(j, cube) * self.output_gain

    def _jumps(
        self, u: FloatArray, x0: FloatArray, forced: FloatArray, edges: IntArray, sums: FloatArray
    ) -> list[ComplexArray]:
        """Columns of a jump of all parameters at each inner edge: Ψ of the trajectory set to 0 before it."""
        cuts = edges[1:-1]
        if not len(cuts):
            return []
        response, at, W = self.response, self.response.at, self.response.bins.window
        z, kept = response.z[: response.bins.kept], response.bins.kept
        free = [x0]
        for length in np.diff(edges).tolist():
            free.append(response.power(length) @ free[-1])
        states = forced + free
        later = np.zeros((W, len(cuts), u.shape[1]))
        for i, cut in enumerate(cuts.tolist()):
            later[cut:, i] = u[cut:]
        U = unitary(later)[:kept]
        turned = np.exp(1j * np.outer(np.angle(z), 1 - cuts))
        ends = turned[:, :, None] * states[1:-1] - z[:, None, None] * states[-1]
        X = (U @ at.B.T + ends / np.sqrt(W)) @ response.R.transpose(0, 2, 1)
        if response.is_free:
            X[0] = (sums[-1] - sums[1:-1]) / np.sqrt(W)
        columns = response.columns(X, U) * self.output_gain[:, None]
        each = columns.reshape(*columns.shape[:2], len(cuts), -1)[..., : self.rig.q]
        return [each.reshape(*columns.shape[:2], -1)]

    def _high(self, fu: ComplexArray, x0: FloatArray, end: FloatArray) -> ComplexArray:
        """The readings (h, p) modelled on the high bins at the same trajectory."""
        bins = self.response.bins
        if not bins.groups:
            return np.zeros((0, len(self.output_gain)), dtype=complex)
        return np.asarray(self.response.above(fu[bins.high], x0, end) * self.output_gain)


def _edge_states(
    A: FloatArray, w: FloatArray, edges: IntArray, power: Callable[[int], FloatArray]
) -> FloatArray:
    """States (len(edges), n) of x(k+1) = A x + w(k) at the edges when started from zero; power: of A."""
    lengths = np.diff(edges)
    padded = np.zeros((len(lengths), lengths.max(), len(A)))
    for i, (start, stop) in enumerate(pairwise(edges.tolist())):
        padded[i, len(padded[i]) - (stop - start) :] = w[start:stop]
    ends = end_states(A, padded)
    states = [np.zeros(len(A))]
    for length, end in zip(lengths.tolist(), ends, strict=True):
        states.append(power(length) @ states[-1] + end)
    return np.array(states)
