"""`deltak identify`: elements of the configured graph from recordings; no nominal is needed, none is trusted.

recordings -> weak form (a start from nothing) -> all windows joined by the estimator's likelihood -> free run
-> values or a refusal. A linear model or a template begins at its nominals, by ever longer windows.
Equations and limits are in docs/identify.md.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import pi
from pathlib import Path
from typing import Any

import numpy as np

from agent.blocks.friction import mechanics_of
from agent.blocks.rig_model import SENSOR_KINDS, RigModel, rig_model
from agent.blocks.statistical_rig import estimator_settings, statistical_rig
from agent.commissioning.channel_checks import plain_findings
from agent.commissioning.explained import Explained, explained, windows_of
from agent.commissioning.nominals import with_nominals, write_nominals
from agent.commissioning.progress import Progress, on_terminal
from agent.commissioning.readings import Recorded
from agent.commissioning.recorded_windows import helping
from agent.commissioning.recording_summary import Material
from agent.config import MechanicsModel, RigConfig, load
from agent.errors import Fault, ModelError, RecordingError, UsageError
from agent.numerics.estimator.settings import EstimatorSettings
from agent.numerics.identification.exact_response import refined
from agent.numerics.identification.pooled import Pooled, pooled
from agent.numerics.identification.response import fitted, measured
from agent.numerics.identification.start import hidden, rests, start, still
from agent.numerics.inference.spectral.columns import Window, window_of
from agent.numerics.inference.tuning import DIGITS, SIGMA_SPREAD_UNSTATED
from agent.numerics.model.holds import straight
from agent.numerics.model.mechanics import MassSpringDamper
from agent.numerics.model.sensors import with_constant
from agent.numerics.model.uncertain import Constant
from agent.runtime.assembly.model_check import model_faults
from agent.text import percent
from agent.types import BoolArray, ComplexArray, FloatArray

PERIODS, WINDOWS, LONGEST = 10, 12, 32_768
"""Periods of the slowest mode in a window, windows of all recordings if possible, most samples per window."""
SHORTEST = 128
FIRST_PERIODS, GROWTH = 2, 6
"""Periods of the fastest mode that oscillates in the first windows of a linear model, and how many times
longer the next ones are."""
UNEXPLAINED = 0.02
"""Share of a motion, its sensor's noise taken off, beyond which the graph is not the machine's."""
PULLED = 5.0
"""Data-sheet standard deviations beyond which a mass or gain that the data ask for is no mass or gain."""
VAGUE = 0.33
"""Sd, as a share of the value, above which a parameter is not known."""
INSEPARABLE = 0.95
"""Correlation from which two vague parameters are named together."""
LEAST = 1e-4
"""Of the largest of its kind: what a start is where noise made it negative."""
T975 = 1.96
LOOK_FOR = "look for an element, a force or a mass that the graph lacks, or for a channel that is wrong"
LOOK_AGAIN = (
    "begin at nominals nearer to the machine's, or look for a state, an input or an offset "
    "that the model lacks, for a channel that is wrong, or for a change within the recordings"
)


@dataclass(frozen=True)
class Found:
    """Everything found: the configuration with it, the rig's parameters, windows, and what they explain."""

    config: RigConfig
    rig: RigModel
    pooled: Pooled
    window: int
    windows: int
    seen: Explained
    constants: tuple[Constant, ...]
    helpful: Mapping[int, str] = field(default_factory=dict)
    """Displacements that would show parameters that are not known, by the parameters' numbers."""


def identify(
    *, config: Path, recordings: Sequence[Path], probe_s: float | None = None, write: bool = False,
    progress: Progress | None = None,
) -> tuple[dict[str, Any], Explained]:  # fmt: skip
    """Identify a rig; return the document of CONTRACT section 8, and predicted against measured motion.

    "ok" is false, with "errors", where the graph is not the machine's; nothing is written then. Raises
    ConfigError, RecordingError, ModelError, UsageError.
    """
    began = time.monotonic()
    said = progress or on_terminal()
    rig = load(config, identified=True)
    try:
        found, span_s = _identified(rig, material_of(recordings, probe_s), said)
    except np.linalg.LinAlgError as error:
        what = "no values of the graph's elements give this motion"
        raise ModelError.at("model", what, LOOK_FOR) from error
    finally:
        said("")
    document = document_of(rig, found) | {"span_s": span_s, "seconds": time.monotonic() - began}
    if write and document["ok"]:
        write_nominals(rig, {change["parameter"]: change["to"] for change in document["changes"]})
        document["written"] = str(config)
    return document, found.seen


def _identified(rig: RigConfig, recordings: Material, progress: Progress) -> tuple[Found, float]:
    if not isinstance(rig.model, MechanicsModel):
        records = read_records(rig, recordings, progress)
        return joined(started_linear(rig, records, progress), records, progress), _span_s(records)
    blank = with_blanks(rig)
    require_motion_sensors(blank)
    records = read_records(blank, recordings, progress)
    progress("solving the weak form")
    begun = started(blank, records)
    if rig.model.friction:
        # the signs of velocities come from a model, which is now a better one
        records = read_records(begun, recordings, progress)
        begun = started(begun, records)
    if faults := model_faults(begun, rig_model(begun)):
        raise ModelError(faults)
    return joined(begun, records, progress), _span_s(records)


def _span_s(records: Sequence[Recorded]) -> float:
    return float(sum(record.facts["span_s"] for record in records))


def started_linear(rig: RigConfig, records: Sequence[Recorded], progress: Progress) -> RigConfig:
    """Return a linear model or template with nominals from ever longer windows, begun at its own.

    Over two periods a motion is nearly that of the nominals, however far off their frequencies are.
    """
    if faults := model_faults(rig, rig_model(rig)):
        raise ModelError(faults)
    last = window_length(rig, records)
    window = first_window_length(rig)
    while window < last:
        said, used, _ = pool(rig, records, window, progress)
        names = [parameter.name for parameter in rig_model(used).parameters]
        rig = with_nominals(rig, dict(zip(names, said.theta.tolist(), strict=True)))
        window *= GROWTH
    return rig


def with_blanks(rig: RigConfig) -> RigConfig:
    """Return a configuration with 1 for every nominal that is to be found."""
    return with_nominals(
        rig, {e.name: 1.0 for e in elements_of(rig.model) if e.name in rig.estimator.estimate}
    )


def elements_of(model: object) -> tuple[Any, ...]:
    """Return the springs, dampers and frictions of a graph; nothing of other models."""
    if not isinstance(model, MechanicsModel):
        return ()
    return (*model.spring, *model.damper, *model.friction)


def mechanics(config: RigConfig) -> MassSpringDamper:
    """Return the parametric model of a graph."""
    found = mechanics_of(rig_model(config).model)
    if found is None:
        raise TypeError("not a mass-spring-damper model")
    return found


def require_motion_sensors(config: RigConfig) -> None:
    """Refuse what nothing can begin with: without a force, a motion that is missing."""
    model = mechanics(config)
    names, nodes = hidden(model)
    if names and not model.forces:
        what = (
            f"{', '.join(names)} cannot be started: "
            f"no displacement or velocity of {', '.join(nodes)} is measured, and no force"
        )
        advice = f"measure the displacement of {', '.join(nodes)}, or a force, or state these nominals"
        raise ModelError.at("channel", what, advice)


def material_of(recordings: Sequence[Path], probe_s: float | None) -> Material:
    """Return what a rig is identified from. Raises UsageError where that is nothing."""
    if not recordings and probe_s is None:
        advice = "name recordings, or listen to the sources with --probe SECONDS"
        raise UsageError.at("RECORDING", "there is nothing to identify from", advice)
    return Material(recordings, probe_s)


def read_records(config: RigConfig, recordings: Material, progress: Progress) -> list[Recorded]:
    """Read recordings. Raises RecordingError, also for channels that two of them read alike or not at all."""
    records = []
    for name, record in recordings.read(config, progress):
        if found := plain_findings(config, record.measured):
            raise RecordingError([Fault(name, row["words"], "mend the channel first") for row in found])
        records.append(record)
    return records


def noise_of_sensors(config: RigConfig, records: Sequence[Recorded]) -> FloatArray:
    """Noise of each output (p,), SI: as high frequencies show it, else as stated, else a sensor's digits."""
    stated = np.array([(c.noise_sd or 0.0) * c.si_factor for c in config.outputs])
    seen = np.median([record.noise for record in records], axis=0)
    spread = np.max([record.y.std(axis=0) for record in records], axis=0)
    return np.asarray(np.maximum(np.where(seen > 0, seen, stated), np.maximum(DIGITS * spread, 1e-300)))


def pieces_of(records: Sequence[Recorded]) -> list[tuple[FloatArray, FloatArray]]:
    """Return outputs and inputs of what has no gap. Raises RecordingError where all is too short."""
    pieces = [(r.y[a:b], r.u[a:b]) for r in records for a, b in r.pieces if b - a >= SHORTEST]
    if not pieces:
        raise _too_short()
    return pieces


def _too_short() -> RecordingError:
    return RecordingError.at("", f"no {SHORTEST} samples without a gap", "give a longer recording")


def started(config: RigConfig, records: Sequence[Recorded]) -> RigConfig:
    """Return the configuration with the weak form's start for nominals. Raises ModelError, RecordingError."""
    model = mechanics(config)
    sigma = noise_of_sensors(config, records)
    pieces = pieces_of(records)
    _require_motion(model, pieces, sigma)
    begin = _from_response if hidden(model)[0] else _from_weak_form
    found = begin(config, model, pieces, sigma)
    return with_nominals(config, _positive(config, dict(zip(model.parameters, found.tolist(), strict=True))))


def _from_weak_form(
    config: RigConfig, model: MassSpringDamper, pieces: Sequence[tuple[FloatArray, FloatArray]],
    sigma: FloatArray,
) -> FloatArray:  # fmt: skip
    return start(
        model, pieces, 1.0 / config.rig.sample_rate_hz, sigma,
        straight=straight(config.estimator.hold) == "first", standing=any(c.bias for c in config.channel),
    )  # fmt: skip


def _from_response(
    config: RigConfig, model: MassSpringDamper, pieces: Sequence[tuple[FloatArray, FloatArray]],
    sigma: FloatArray,
) -> FloatArray:  # fmt: skip
    hold = straight(config.estimator.hold)
    period_s = 1.0 / config.rig.sample_rate_hz
    seen = measured(pieces, period_s, sigma, straight=hold == "first")
    if not len(seen.omega):
        advice = "record longer, or with more force; or measure the displacements that are missing"
        raise RecordingError.at("", "no motion answers the measured forces", advice)
    minima = refined(
        model, pieces, period_s, sigma, fitted(model, seen), fastest=float(seen.omega[-1]), hold=hold
    )
    return minima[0].theta


def _require_motion(
    model: MassSpringDamper, pieces: Sequence[tuple[FloatArray, FloatArray]], sigma: FloatArray
) -> None:
    quiet, nodes = still(model, pieces, sigma)
    if rests(pieces, sigma):
        raise RecordingError.at(
            "", "nothing moves beyond the noise of its sensor", "record while the machine moves"
        )
    if quiet:
        where = f"{', '.join(nodes)} rests" if nodes else "both ends move as one"
        what = f"{', '.join(quiet)} cannot be known: {where} in all of the recordings"
        raise ModelError.at(
            "estimator.estimate", what, "record a motion that stretches them, or state their nominals"
        )


def _positive(config: RigConfig, values: Mapping[str, float]) -> dict[str, float]:
    """Return values of which none is negative: a motion that grows by itself starts no estimate."""
    kinds = {name: config.parameters[name].kind for name in values}
    largest = {
        kind: max([v for n, v in values.items() if kinds[n] == kind and v > 0], default=1.0)
        for kind in kinds.values()
    }
    return {name: max(value, LEAST * largest[kinds[name]]) for name, value in values.items()}


def poles_of(config: RigConfig) -> ComplexArray:
    """Return the poles at nominal (n,), rad/s."""
    model = rig_model(config).model
    at = model.continuous(model.nominal)
    poles: ComplexArray = np.asarray(np.linalg.eigvals(at.A), dtype=np.complex128)
    if at.is_sampled:
        rate = np.log(np.where(poles == 0, LEAST + 0j, poles)) * config.rig.sample_rate_hz
        return np.asarray(rate, dtype=np.complex128)
    return poles


def first_window_length(config: RigConfig) -> int:
    """Return the length of a linear model's first windows, samples: periods of the fastest oscillation."""
    poles = poles_of(config)
    rate = config.rig.sample_rate_hz
    oscillating = np.abs(poles[(np.abs(poles.imag) > np.abs(poles.real)) & (np.abs(poles) < pi * rate / 2)])
    period_s = 2 * pi / oscillating.max() if len(oscillating) else slowest_period_s(config)
    return int(np.clip(FIRST_PERIODS * period_s * rate, SHORTEST, LONGEST))


def slowest_period_s(config: RigConfig) -> float:
    """Return the period of the slowest mode at nominal, s."""
    speeds = np.abs(poles_of(config))
    return float(2 * pi / np.min(speeds[speeds > 1e-6 * speeds.max()], initial=speeds.max()))


def window_length(config: RigConfig, records: Sequence[Recorded]) -> int:
    """Return the length of the windows that are joined, samples: some periods of the slowest mode."""
    lengths = [b - a for record in records for a, b in record.pieces]
    if max(lengths, default=0) < SHORTEST:
        raise _too_short()
    wanted = max(
        PERIODS * slowest_period_s(config) * config.rig.sample_rate_hz, sum(lengths) / WINDOWS, SHORTEST
    )
    longest = max(lengths)
    # equal parts of the longest piece: a remainder would be lost
    return min(longest // max(1, int(longest / wanted)), LONGEST)


def joined(begun: RigConfig, records: Sequence[Recorded], progress: Progress) -> Found:
    """Estimate by all windows together, and run the result free through them."""
    window = window_length(begun, records)
    said, config, count = pool(begun, records, window, progress)
    progress("running the model free")
    rig = rig_model(config)
    names = [parameter.name for parameter in rig.parameters]
    found = with_nominals(config, dict(zip(names, said.theta.tolist(), strict=True)))
    constants = statistical_rig(config).constants
    noise = noise_of_sensors(config, records)
    seen = explained(_weighed(found, said, constants), said.theta, records, window, noise)
    whole = Found(found, rig, said, window, count, seen, constants)
    return replace(whole, helpful=_helpful(whole, records[0], noise))


def _helpful(found: Found, record: Recorded, noise: FloatArray) -> dict[int, str]:
    """Return the displacement that would show each parameter that is not known, where there is one."""
    if not isinstance(found.config.model, MechanicsModel):
        return {}
    restless = found.pooled.restless
    unknown = [i for i in range(len(found.rig.parameters)) if restless[i] or _why(found, i)]
    ways = helping(found.config, record, found.window, found.windows, noise) if unknown else []
    size = VAGUE * np.abs(found.pooled.theta)
    shown = {i: [place for place, sd in ways if sd[i] < size[i]] for i in unknown}
    return {i: places[0] for i, places in shown.items() if places}


def pool(
    begun: RigConfig, records: Sequence[Recorded], window: int, progress: Progress
) -> tuple[Pooled, RigConfig, int]:  # fmt: skip
    """Join all windows of so many samples; return what they say, the configuration used, and their number."""
    config, settings, windows = windowed(begun, records, window)
    noise = noise_of_sensors(config, records)
    known = np.isfinite(settings.sigma)
    sigma = np.where(known, settings.sigma, noise)
    spread = np.where(known, settings.sigma_spread, SIGMA_SPREAD_UNSTATED)
    said = pooled(settings.rig, windows, sigma, spread, settings.floor, progress)
    return said, config, len(windows)


def windowed(
    begun: RigConfig, records: Sequence[Recorded], window: int
) -> tuple[RigConfig, EstimatorSettings, list[Window]]:
    """Return the configuration with windows of so many samples, the estimator's settings, and the windows."""
    length = window / begun.rig.sample_rate_hz
    # a polynomial between samples differs from lines by little
    update = {
        "window_s": length,
        "hop_s": length,
        "method": "window-ml",
        "hold": straight(begun.estimator.hold),
    }
    config = begun.model_copy(update={"estimator": begun.estimator.model_copy(update=update)})
    settings = estimator_settings(config, np.zeros(len(config.outputs)))
    columns = len(settings.rig.measured)
    windows = []
    for record in records:
        u = with_constant(record.u, columns)
        for a, b in windows_of(record, window):
            windows.append(window_of(record.y[a:b], u[a:b], u[a - 1] if a else None))
    return config, settings, windows


def _weighed(config: RigConfig, said: Pooled, constants: Sequence[Constant]) -> RigConfig:
    """Return the configuration with masses as the data have them: the values were found with these."""
    pairs = [(c.name, eta) for c, eta in zip(constants, said.eta.tolist(), strict=True) if c.kind == "mass"]
    known = config.parameters
    return with_nominals(config, {name: float(known[name].nominal * np.exp(eta)) for name, eta in pairs})


def document_of(rig: RigConfig, found: Found) -> dict[str, Any]:
    """Return the document of CONTRACT section 8, but for what only the command knows."""
    errors = list(_refusals(rig, found))
    rows = {p.name: _row(found, i) for i, p in enumerate(found.rig.parameters)}
    shares = {c.name: 100.0 * s for c, s in zip(rig.outputs, found.seen.share.tolist(), strict=True)}
    return {
        "rig": rig.rig.name, "ok": not errors, "parameters": rows,
        "unexplained_percent": max(shares.values()),
        "unexplained": shares, "graph": [], "windows": found.windows,
        "window_s": found.window / rig.rig.sample_rate_hz, "scatter": found.pooled.scatter,
        "changes": _changes(rig, rows), "written": None,
        "errors": [{"path": e.path, "message": e.message, "advice": e.advice} for e in errors],
    }  # fmt: skip


def _refusals(rig: RigConfig, found: Found) -> list[Fault]:
    """Return why the model is not the machine's; empty where it is."""
    is_graph = isinstance(rig.model, MechanicsModel)
    what, advice = ("the graph", LOOK_FOR) if is_graph else ("the model", LOOK_AGAIN)
    worst = [
        Fault("model", f"{what} leaves {percent(share)} of the motion of {channel.name} unexplained", advice)
        for channel, share in zip(rig.outputs, found.seen.beyond.tolist(), strict=True)
        if not share <= UNEXPLAINED
    ]
    if worst:
        return worst
    if pulled := _pulled(found):
        return [Fault("model", f"{what} fits only with {pulled} than configured", advice)]
    if not found.pooled.converged:
        return [_disagreement(found, advice)]
    return []


def _disagreement(found: Found, advice: str) -> Fault:
    """Say on which parameters windows do not agree, and what would show them."""
    names = [p.name for p, moves in zip(found.rig.parameters, found.pooled.restless, strict=True) if moves]
    places = list(dict.fromkeys(found.helpful.values()))
    way = f"measure the displacement of {' or '.join(places)}, record longer, or " if places else ""
    message = f"the windows of the recordings agree on no values of {', '.join(names)}"
    return Fault("model", message, way + advice)


def _pulled(found: Found) -> str:
    """Return the constant that the data pull beyond its data sheet, in words; nothing where none is."""
    pairs = [
        (c, eta)
        for c, eta in zip(found.constants, found.pooled.eta.tolist(), strict=True)
        if c.kind != "delay"
    ]
    constant, eta = max(pairs, key=lambda pair: abs(pair[1]) / pair[0].sheet, default=(None, 0.0))
    if constant is None or abs(eta) <= PULLED * constant.sheet:
        return ""
    what = constant.name if constant.kind == "mass" else f"the gain of {constant.name}"
    return f"{what} {percent(np.expm1(eta))} {'more' if eta > 0 else 'less'}"


def _row(found: Found, i: int) -> dict[str, Any]:
    value, sd = float(found.pooled.theta[i]), float(found.pooled.sd[i])
    why = _why(found, i)
    return {
        "value": value, "sd": sd, "sd_repeat": float(found.pooled.sd_repeat[i]), "lower": value - T975 * sd,
        "upper": value + T975 * sd, "unit": found.rig.parameters[i].unit, "identifiable": why is None,
        "why": why,
    }  # fmt: skip


def _why(found: Found, i: int) -> str | None:
    """Return why a parameter is not known, and what would show it; None where it is."""
    parameter, said = found.rig.parameters[i], found.pooled
    vague = (said.sd > VAGUE * np.abs(said.theta)) | _lines(found)
    if parameter.kind in ("bias", "gain") or not vague[i]:
        return None
    way = f"measure the displacement of {found.helpful[i]}, " if i in found.helpful else ""
    others = [
        p.name for j, p in enumerate(found.rig.parameters)
        if j != i and vague[j] and abs(said.correlation[i, j]) > INSEPARABLE
    ]  # fmt: skip
    if others:
        named = ", ".join(others)
        advice = f"{way}record a motion that moves them differently, or state one of them"
        return f"inseparable from {named}: {advice}"
    return (
        f"unexcited: its part of the motion is too small; {way}record longer, or with more motion across it"
    )


def _lines(found: Found) -> BoolArray:
    """Return which parameters (q,) are springs at an unmeasured mass beside a damper that is not known.

    Noise has lines as sharp as that resonance may be: one of them is no spring, however well it fits.
    """
    model = found.config.model
    if not isinstance(model, MechanicsModel):
        return np.zeros(len(found.rig.parameters), dtype=bool)
    unseen = set(hidden(mechanics(found.config))[1])
    values = dict(zip((p.name for p in found.rig.parameters), found.pooled.theta.tolist(), strict=True))
    sds = dict(zip(values, found.pooled.sd.tolist(), strict=True))
    open_ends = [
        set(e.between) for e in model.damper if e.name in values and sds[e.name] > VAGUE * abs(values[e.name])
    ]
    springs = [e for e in model.spring if unseen & set(e.between)]
    names = {e.name for e in springs if set(e.between) in open_ends}
    return np.array([name in names for name in values], dtype=bool)


def _changes(rig: RigConfig, rows: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return what --write puts into the file: values of elements, masses and entries that are known."""
    known = rig.parameters
    changes = []
    for name, row in rows.items():
        before, kind = known[name].nominal, known[name].kind
        if kind not in SENSOR_KINDS and row["identifiable"]:
            old = None if np.isnan(before) else before
            new = f"{row['value']:.10g}" if kind == "linear" else f"{max(row['value'], 0.0):.6g}"
            changes.append({"parameter": name, "from": old, "to": float(new)})
    return changes
