"""Readings gathered for commissioning, from a recording or the sources, and what each channel shows."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np

from agent.blocks.acquisition.interface import SourceState
from agent.blocks.acquisition.source_clocks import SourceClocks
from agent.blocks.covariates.readings import readings
from agent.blocks.friction import dry_friction
from agent.commissioning.tuning import AHEAD, CALM, LEAST_ROWS, MOST_ROWS, ORDER, REACH
from agent.config import RigConfig
from agent.config.sections.covariates import Covariate
from agent.numerics.model.sensors import with_constant
from agent.numerics.model.statespace import Discrete, simulate
from agent.runtime.assembly.acquisition_plan import Maps, channels_of, make_acquisition
from agent.types import Aligned, FloatArray
from drivers.port import Counts, SampleBlock


@dataclass(frozen=True, slots=True)
class Recorded:
    """A recording's samples in SI units.

    Attributes:
        name: of the file, or "the probe".
        measured: (N, c) readings of the channels, inputs first.
        u, y: (N, m) the model's inputs (with the signs of dry friction), (N, p) outputs.
        pieces: uninterrupted stretches as (first, end) rows.
        noise: (p,) standard deviation of each output's noise as its high frequencies show it; 0 where too
            short.
        facts: for the document.
    """

    name: str
    measured: FloatArray
    u: FloatArray
    y: FloatArray
    pieces: tuple[tuple[int, int], ...]
    noise: FloatArray
    facts: dict[str, Any]

    def first_state(self, discrete: Discrete, start: int, stop: int) -> FloatArray:
        """Return the state (n,) at row `start` that explains the first readings of a stretch best."""
        model, stop = discrete.model, min(stop, start + 2000)
        u = with_constant(self.u[start:stop], model.m)
        shift = discrete.B1 @ u[0]
        _, forced = simulate(discrete, shift, u)
        free = np.empty((len(u), model.p, model.n))
        row = model.C
        for k in range(len(u)):
            free[k], row = row, row @ model.A
        found = np.linalg.lstsq(
            free.reshape(-1, model.n), (self.y[start:stop] - forced).ravel(), rcond=1e-12
        )[0]
        return np.asarray(found + shift)


class Gathering:
    """Collects blocks of a rig's sources and says what they hold.

    Args:
        config: the rig's configuration.
        sources: names of the sources that deliver, with their channel -> field maps.
        keep: whether samples are kept for `recorded`; without them listening may last for days.
        covariates: those that are listened to, whose readings `take_covariates` takes.
    """

    def __init__(
        self, config: RigConfig, sources: Maps, *, keep: bool = True, covariates: Sequence[Covariate] = ()
    ) -> None:
        self._config, self._maps, self._keep = config, sources, keep
        self.acquisition = make_acquisition(
            config, sources, np.zeros(len(config.outputs)), keep_incomplete=False
        )
        self.counts = {name: Counts() for name in sources}
        self._clocks = SourceClocks()
        self._aligned: list[Aligned] = []
        self._missing: Counter[str] = Counter()
        self._span_ns: dict[str, tuple[int, int, int]] = {}
        self._listened = covariates
        self._beside: dict[str, list[FloatArray]] = {one.name: [] for one in covariates}

    def take(self, source: str, block: SampleBlock, modulus: int | None) -> None:
        """Take a block as it was read."""
        if not len(block):
            return
        for column, channel in enumerate(self._maps[source]):
            self._missing[channel] += int((~np.isfinite(block.values[:, column])).sum())
        aligned = _paired(self.acquisition.step(source, block, modulus).values)
        self._aligned += aligned if self._keep else []
        if block.wall_offset_ns is not None:
            self._received(self.acquisition.sources[source], block.arrival_ns)

    def take_covariates(self, block: SampleBlock, places: Mapping[str, int]) -> None:
        """Take the readings of covariates, which stand in these columns of a block."""
        for name, values in readings(block, places).items():
            self._beside[name].append(np.asarray(values, dtype=float))

    def _received(self, state: SourceState, arrival_ns: int) -> None:
        self._clocks.observe(state, arrival_ns)
        if state.newest is not None:
            first = self._span_ns.get(state.plan.name, (state.newest, arrival_ns, 0))
            self._span_ns[state.plan.name] = (first[0], first[1], arrival_ns)

    def finish(self) -> None:
        """Take what waits for samples that will not come."""
        self._aligned += _paired(self.acquisition.finish().values)

    def recorded(self, name: str, config: RigConfig | None = None) -> Recorded | None:
        """Return what came, in SI units; None where no sample has every channel.

        config: whose nominals give the signs of dry friction; by default those with which samples were
        gathered.
        """
        if not self._aligned:
            return None
        u, y = np.vstack([a.u for a in self._aligned]), np.vstack([a.y for a in self._aligned])
        friction = dry_friction(config or self._config, np.zeros(y.shape[1]))
        inputs = np.vstack([friction.step(a) for a in self._aligned])
        noise = np.array([noise_of(y[:, r], u) for r in range(y.shape[1])])
        v = np.hstack([u, y])
        return Recorded(name, v, inputs, y, _pieces(self._aligned), noise, self._facts(v, noise))

    def sources(self) -> list[dict[str, Any]]:
        """Return what is known of each source: rate, ledger, clock, skew."""
        return [self._source(name) for name in self._maps]

    def _source(self, name: str) -> dict[str, Any]:
        state, counts = self.acquisition.sources[name], self.counts[name]
        clock = self._clocks.report(name, *self.acquisition.skews().get(name, (None, None)))
        return {
            "name": name, "received": counts.received, "rejected": dict(counts.rejected + state.refusals()),
            "first_rejected": dict(counts.first), "dropped": dict(counts.dropped),
            "gaps": state.gaps, "missing": state.missing,
            "rate_hz": self._rate(state), "nominal_hz": state.indexer.rate_hz,
            "drift_ppm": None if clock is None else clock.drift_ppm,
            "drift_sd_ppm": None if clock is None else clock.drift_sd_ppm,
            "skew_s": None if clock is None else clock.skew_s,
            "skew_sd_s": None if clock is None else clock.skew_sd_s,
        }  # fmt: skip

    def _rate(self, state: SourceState) -> float | None:
        """Samples a second by the gateway's clock; of a recording None."""
        first, began, ended = self._span_ns.get(state.plan.name, (0, 0, 0))
        if state.newest is None or ended <= began:
            return None
        # gaps count as no samples
        counted = state.newest - first - state.missing
        return 1e9 * max(counted, 0) / (ended - began)

    def _facts(self, v: FloatArray, noise: FloatArray) -> dict[str, Any]:
        index = np.concatenate([a.index for a in self._aligned])
        span = int(index[-1] - index[0]) / self._config.rig.sample_rate_hz
        sources = self.sources()
        owner = {channel: source for source in sources for channel in self._maps[source["name"]]}
        noises = [_calm(v[:, c]) for c in range(v.shape[1] - len(noise))] + noise.tolist()
        rate = (len(index) - 1) / span if span else None
        channels = channels_of(self._config)
        factors = np.array(
            [channel.si_factor for channel in channels]
        )  # what people state is in a channel's own unit
        shown = [
            {
                "name": channel.name, "unit": channel.unit, "source": owner[channel.name]["name"],
                "rate_hz": owner[channel.name]["rate_hz"] or rate, "min": float(values.min()),
                "max": float(values.max()), "rms": float(np.sqrt(np.mean(values**2))),
                "noise_sd": None if sd is None else sd / channel.si_factor,
                "gaps": owner[channel.name]["gaps"], "missing": self._missing[channel.name],
                "drift_ppm": owner[channel.name]["drift_ppm"],
                "drift_sd_ppm": owner[channel.name]["drift_sd_ppm"],
            }
            for channel, values, sd in zip(channels, (v / factors).T, noises, strict=True)
        ]  # fmt: skip
        rejected: Counter[str] = Counter()
        for source in sources:
            rejected.update(source["rejected"])
        return {
            "span_s": span, "received": sum(s["received"] for s in sources), "used": len(index),
            "gaps": sum(s["gaps"] for s in sources), "missing": sum(s["missing"] for s in sources),
            "rejected": dict(rejected), "channels": [*shown, *self._covariates()], "sources": sources,
            "suspicions": [],
        }  # fmt: skip

    def _covariates(self) -> Iterator[dict[str, Any]]:
        """Yield what covariates read, in their own units; None where nothing came."""
        owner = {name: source.name for source in self._config.covariate_source for name in source.covariates}
        owner |= {name: source.name for source in self._config.source for name in source.covariates}
        for one in self._listened:
            raw = np.concatenate([np.zeros(0), *self._beside[one.name]])
            values = raw[np.isfinite(raw)] * one.scale + one.offset
            figures = (values.min(), values.max(), np.sqrt(np.mean(values**2))) if len(values) else ()
            seen = dict(zip(("min", "max", "rms"), map(float, figures), strict=False))
            yield {
                "name": one.name, "unit": one.unit, "source": owner.get(one.name), "rate_hz": None,
                "min": seen.get("min"), "max": seen.get("max"), "rms": seen.get("rms"), "noise_sd": None,
                "gaps": 0, "missing": len(raw) - len(values), "drift_ppm": None, "drift_sd_ppm": None,
            }  # fmt: skip


def _paired(pieces: Sequence[Aligned]) -> list[Aligned]:
    """Leave out what may not go together, after a device of several began to count anew."""
    return [piece for piece in pieces if not piece.realigning]


def _calm(signal: FloatArray) -> float | None:
    """The noise of an input, where it is smooth enough to tell."""
    found = noise_of(signal)
    return found if found < CALM * float(np.sqrt(np.mean(signal**2))) else None


def _pieces(aligned: list[Aligned]) -> tuple[tuple[int, int], ...]:
    """Join blocks of one segment."""
    pieces: list[tuple[int, int]] = []
    row, segment = 0, None
    for block in aligned:
        end = row + len(block.index)
        if block.segment == segment:
            pieces[-1] = (pieces[-1][0], end)
        else:
            pieces.append((row, end))
        row, segment = end, block.segment
    return tuple(pieces)


def noise_of(signal: FloatArray, forces: FloatArray | None = None) -> float:
    """Estimate white noise from the sixth difference, by its median so that jumps do not count.

    forces (N, m): what drives the signal; what they explain is motion, as an accelerometer shows a force at
    once.
    """
    if len(signal) < 10 * ORDER:
        return 0.0
    left = _unexplained(np.diff(signal, ORDER), None if forces is None else np.diff(forces, ORDER, axis=0))
    spread = 1.4826 * float(np.median(np.abs(left)))
    return float((spread or float(np.std(left))) / comb(2 * ORDER, ORDER) ** 0.5)


def _unexplained(signal: FloatArray, forces: FloatArray | None) -> FloatArray:
    """Return what the newest forces (N, m), by least squares, leave of a signal (N,)."""
    if forces is None or not forces.size or len(signal) < LEAST_ROWS * REACH * forces.shape[1]:
        return signal
    signal, forces = signal[-MOST_ROWS:], forces[-MOST_ROWS:]
    near = np.lib.stride_tricks.sliding_window_view(forces, REACH, axis=0).reshape(
        len(signal) - REACH + 1, -1
    )
    here = signal[REACH - 1 - AHEAD : len(signal) - AHEAD]
    scale = np.maximum(np.abs(near).max(axis=0), 1e-300)
    return np.asarray(here - near / scale @ np.linalg.lstsq(near / scale, here, rcond=1e-10)[0])
