"""`deltak excite`: the most telling force that the machine allows, as a file for the operator's shaker.

model -> information of each line -> optimal powers -> multisine of small peak -> scaled to force and stroke
-> CSV
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from agent.blocks.rig_model import RigModel, rig_model
from agent.blocks.statistical_rig import statistical_rig
from agent.commissioning.check import resolution_of
from agent.commissioning.excitation.lines import Lines, candidate_lines
from agent.commissioning.numerics.design import Design, line_information, optimal
from agent.commissioning.numerics.information import PredictedSd, predicted_sd
from agent.commissioning.numerics.multisine import crest, multisine
from agent.commissioning.prediction import Excitation, completed, expected_noise, sampled
from agent.commissioning.progress import Progress, on_terminal
from agent.commissioning.readings import Recorded
from agent.commissioning.recording_summary import read_recording
from agent.commissioning.tuning import MOST_SAMPLES, MOVING_TIMES, ROUNDING, SHOWN_SHARE, SIGNAL_DIGITS
from agent.config import RigConfig, load
from agent.errors import ModelError, RecordingError, UsageError
from agent.numerics.model.holds import straight
from agent.numerics.model.sensors import with_constant
from agent.numerics.model.statespace import Discrete, simulate
from agent.runtime.assembly.model_check import model_faults
from agent.text import number, percent
from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class Bounds:
    """What the machine allows: most force and stroke in channel units, None for any; band, Hz; seconds."""

    seconds: float
    force: float | None = None
    stroke: float | None = None
    band: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class _Rig:
    """A configuration and its sampled model, with noise (p,) of its outputs and what the noise rests on."""

    config: RigConfig
    model: RigModel
    discrete: Discrete
    sigma: FloatArray
    words: str


def excite(
    *, config: Path, recording: Path | None, bounds: Bounds, to: Path, progress: Progress | None = None
) -> dict[str, Any]:
    """Write the signal and return the document of CONTRACT section 8.

    Raises ConfigError, ModelError, RecordingError, UsageError; nothing is written then.
    """
    said = progress or on_terminal()
    rig_config = load(config)
    recorded = _moving(rig_config, recording) if recording is not None else None
    try:
        document, u = _designed(_rig(rig_config, recorded), recorded, _checked(bounds, rig_config), said)
    finally:
        said("")
    _write(to, rig_config, u)
    return document | {"to": str(to)}


def _rig(config: RigConfig, recorded: Recorded | None) -> _Rig:
    if not config.inputs:
        advice = "add the channel that measures it; a rig without one is let go by hand"
        raise ModelError.at("channel", "there is no force that could excite the rig", advice)
    model = rig_model(config)
    if faults := model_faults(config, model):
        raise ModelError(faults)
    discrete = sampled(config, model)
    rms = np.ones(discrete.model.p) if recorded is None else np.asarray(np.std(recorded.y, axis=0))
    nothing = Excitation(np.zeros((0, discrete.model.m)), lambda _: [], lambda *_: np.zeros(0), rms, "")
    sigma, words = expected_noise(config, resolution_of(config), nothing, recorded)
    return _Rig(config, model, discrete, sigma, words)


def _moving(config: RigConfig, recording: Path) -> Recorded:
    recorded = read_recording(config, recording)
    moved = np.std(recorded.y, axis=0)
    least = np.maximum(MOVING_TIMES * recorded.noise, ROUNDING * np.abs(recorded.y).max(axis=0))
    if not np.any(moved > least):
        what = "nothing moves beyond the noise of its sensor"
        raise RecordingError.at(
            recording, what, "give one that was recorded while the machine moved, or none"
        )
    return recorded


def _checked(bounds: Bounds, config: RigConfig) -> Bounds:
    given = {"--seconds": bounds.seconds, "--max-force": bounds.force, "--max-stroke": bounds.stroke}
    for option, value in given.items():
        if value is not None and not 0.0 < value < np.inf:
            raise UsageError.at(option, f"{value:g} is none", "give a number above 0")
    if bounds.seconds * config.rig.sample_rate_hz > MOST_SAMPLES:
        most = MOST_SAMPLES / config.rig.sample_rate_hz
        raise UsageError.at(
            "--seconds", f"{bounds.seconds:g} s is too long", f"give {most:g} s at most and repeat it"
        )
    if bounds.band is not None and not 0.0 <= bounds.band[0] < bounds.band[1]:
        raise UsageError.at(
            "--band", f"{bounds.band[0]:g} to {bounds.band[1]:g} Hz is no band", "give LO below HI"
        )
    return bounds


def _designed(
    rig: _Rig, recorded: Recorded | None, bounds: Bounds, progress: Progress
) -> tuple[dict[str, Any], FloatArray]:
    progress("weighing frequencies")
    count = round(bounds.seconds * rig.config.rig.sample_rate_hz)
    inputs = len(rig.config.inputs)
    lines = candidate_lines(rig.discrete, count, inputs, bounds.band)
    design, kept = _design(rig, lines, count)
    progress("shaping the signal")
    shape = _shape(lines, design.power, count, inputs)
    u, words = _scaled(rig, shape, bounds, recorded)
    progress("predicting what it teaches")
    expected = _expected(rig, u)
    past = None if recorded is None else _of_recording(rig, recorded)
    names = [parameter.name for parameter in rig.model.parameters]
    named = list(_named(rig, lines, design.power, count))
    force = _force(rig, u)
    stroke = _stroke(rig, u)
    document = {
        "rig": rig.config.rig.name, "seconds": bounds.seconds, "samples": count,
        "design_gap": max(design.gap, 0.0),
        "designed_for": [name for name, own in zip(names, kept.tolist(), strict=True) if own],
        "predicted_sd": dict(zip(names, expected.scatter.tolist(), strict=True)),
        "sd_repeat": dict(zip(names, expected.sd_repeat.tolist(), strict=True)),
        "against_nominal_sd": dict(zip(names, expected.sd.tolist(), strict=True)),
        "recording_sd": None if past is None else dict(zip(names, past.tolist(), strict=True)),
        "recording_s": None if recorded is None else recorded.facts["span_s"],
        "units": {parameter.name: parameter.unit for parameter in rig.model.parameters},
        "peak_force": force, "force_unit": rig.config.inputs[0].unit, "peak_stroke": stroke,
        "stroke_unit": _stroke_unit(rig.config), "crest_factor": crest(u[:, 0]), "lines": named,
        "assumes": rig.words,
    }  # fmt: skip
    return document | {"advice": [words, *_advice(document, past, expected, names)]}, u


def _design(rig: _Rig, lines: Lines, count: int) -> tuple[Design, FloatArray]:
    """Return the best powers, and which parameters lines teach at all: no offsets and no dry friction."""
    information = np.zeros((len(lines.periods), *(2 * [rig.discrete.model.q])))
    omega = 2.0 * np.pi * lines.periods / (count * rig.discrete.period_s)
    for column in np.unique(lines.column):
        own = lines.column == column
        information[own] = line_information(rig.discrete, omega[own], int(column), rig.sigma)
    taught = np.einsum("fkk->k", information) > 0.0
    try:
        return optimal(information[:, taught][:, :, taught]), taught
    except ValueError as error:
        advice = "widen --band, or measure more of the motion"
        raise ModelError.at(
            "estimator.estimate", f"no force of this band teaches it: {error}", advice
        ) from error


def _shape(lines: Lines, power: FloatArray, count: int, inputs: int) -> FloatArray:
    """Return the signal (count, m) of each input, together of rms 1."""
    u = np.zeros((count, inputs))
    for column in range(inputs):
        own = (lines.column == column) & (power > 0.0)
        if own.any():
            u[:, column] = multisine(power[own], lines.periods[own], count)
    return u


def _scaled(
    rig: _Rig, shape: FloatArray, bounds: Bounds, recorded: Recorded | None
) -> tuple[FloatArray, str]:
    """Return the signal as large as is allowed, SI, and in words by what."""
    ways = {}
    if bounds.force is not None:
        ways["--max-force"] = bounds.force / _force(rig, shape)
    if bounds.stroke is not None:
        ways["--max-stroke"] = bounds.stroke / _stroke(rig, shape)
    if ways:
        option = min(ways, key=ways.__getitem__)
        return ways[option] * (1.0 - 1e-9) * shape, f"as large as {option} allows"
    if recorded is not None:
        inputs = recorded.u[:, : shape.shape[1]]
        return float(
            np.sqrt(np.sum(np.var(inputs, axis=0)))
        ) * shape, f"of the force's rms in {recorded.name}"
    return shape, f"of 1 {rig.config.inputs[0].si_unit} rms; --max-force and --max-stroke say what is allowed"


def _force(rig: _Rig, u: FloatArray) -> float:
    """Return the greatest force of any input, in the first one's unit."""
    return float(np.abs(u).max()) / rig.config.inputs[0].si_factor


def _stroke(rig: _Rig, u: FloatArray) -> float:
    """Return the greatest displacement from rest: of all masses, or of all outputs where there are none."""
    columns = [i for i, name in enumerate(rig.model.model.state_names) if name.startswith("displacement")]
    whole = np.zeros((len(u), rig.discrete.model.m))
    whole[:, : u.shape[1]] = u  # without offsets and dry friction
    states, y = simulate(rig.discrete, np.zeros(rig.discrete.model.n), whole)
    moved = states[:, columns] if columns else y
    return float(np.abs(moved).max()) / _stroke_factor(rig.config)


def _stroke_factor(config: RigConfig) -> float:
    return next((channel.si_factor for channel in config.outputs if channel.quantity == "displacement"), 1.0)


def _stroke_unit(config: RigConfig) -> str:
    return next((channel.unit for channel in config.outputs if channel.quantity == "displacement"), "m")


def _expected(rig: _Rig, u: FloatArray) -> PredictedSd:
    """Return the sds to expect of the whole signal from rest."""
    x0 = np.zeros(rig.discrete.model.n)
    inputs = completed(rig.config, rig.discrete, x0, u)
    return predicted_sd(_straight(rig), x0 - rig.discrete.B1 @ inputs[0], inputs, rig.sigma)


def _straight(rig: _Rig) -> Any:
    return replace(statistical_rig(rig.config), hold=straight(rig.config.estimator.hold))


def _of_recording(rig: _Rig, recorded: Recorded) -> FloatArray:
    """Return sds (q,) to expect of the whole recording, all pieces together."""
    u = with_constant(recorded.u, rig.discrete.model.m)
    found = []
    for first, end in recorded.pieces:
        last = min(end, first + MOST_SAMPLES)
        if last - first > rig.discrete.model.n + rig.discrete.model.q:
            x0 = recorded.first_state(rig.discrete, first, last) - rig.discrete.B1 @ u[first]
            found.append(predicted_sd(_straight(rig), x0, u[first:last], rig.sigma).scatter)
    if not found:
        return np.full(rig.discrete.model.q, np.inf)
    return np.asarray(1.0 / np.sqrt(np.sum([1.0 / sd**2 for sd in found], axis=0)))


def _named(rig: _Rig, lines: Lines, power: FloatArray, count: int) -> Iterator[dict[str, Any]]:
    """Yield the lines that carry power, the strongest first."""
    for i in np.argsort(-power):
        if power[i] <= 0.0:
            return
        hertz = float(lines.periods[i] / (count * rig.discrete.period_s))
        yield {"hz": hertz, "power": float(power[i]), "input": rig.config.inputs[int(lines.column[i])].name}


def _advice(
    document: Mapping[str, Any], past: FloatArray | None, expected: PredictedSd, names: Sequence[str]
) -> Iterator[str]:
    """Yield in words where the power is, and what the recording at hand would take to teach as much."""
    several = len({line["input"] for line in document["lines"]}) > 1
    strong = [
        f"{number(line['hz'], 3)} Hz{' on ' + line['input'] if several else ''} with {percent(line['power'])}"
        for line in document["lines"]
        if line["power"] >= SHOWN_SHARE
    ]
    yield f"of the power {', '.join(strong)}"
    if past is None:
        return
    ratio = (past / expected.scatter) ** 2
    for i in np.argsort(-ratio):
        if np.isfinite(ratio[i]) and ratio[i] > 0.0:
            words = f"{number(float(ratio[i]), 2)} × longer"
            yield f"{names[i]}: the recording at hand would have to be {words} to tell as much"
        else:
            yield f"{names[i]}: the recording at hand tells nothing of it"


def _write(to: Path, config: RigConfig, u: FloatArray) -> None:
    """Write time and forces, in their channels' units, as a recording has them. Raises UsageError."""
    factor = np.array([channel.si_factor for channel in config.inputs])
    rate = config.rig.sample_rate_hz
    rows = [",".join(["t", *(channel.name for channel in config.inputs)])]
    for k, row in enumerate((u / factor).tolist()):
        rows.append(",".join([f"{k / rate:.9g}", *(f"{value:.{SIGNAL_DIGITS}g}" for value in row)]))
    try:
        to.write_text("\n".join([*rows, ""]), encoding="utf-8")
    except OSError as error:
        advice = "give a file in a folder that you may write to"
        raise UsageError.at("--to", f"{to}: {error.strerror or error}", advice) from error
