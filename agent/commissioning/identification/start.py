"""Starts of an estimate: by weak form or frequency response from nothing, or from ever longer windows."""

from collections.abc import Mapping, Sequence

import numpy as np

from agent.blocks.rig_model import rig_model
from agent.commissioning.identification.graph import mechanics
from agent.commissioning.identification.material import noise_of_sensors, pieces_of
from agent.commissioning.identification.windows import first_window_length, pool, window_length
from agent.commissioning.nominals import with_nominals
from agent.commissioning.numerics.motion.exact_response import others_near, refined
from agent.commissioning.numerics.motion.response import fitted, measured
from agent.commissioning.numerics.motion.start import hidden, rests, start, still
from agent.commissioning.progress import Progress
from agent.commissioning.readings import Recorded
from agent.commissioning.tuning import GROWTH, LEAST_START
from agent.config import RigConfig
from agent.errors import ModelError, RecordingError
from agent.numerics.model.holds import straight
from agent.numerics.model.mechanics import MassSpringDamper
from agent.runtime.assembly.model_check import model_faults
from agent.types import FloatArray


def started(config: RigConfig, records: Sequence[Recorded]) -> RigConfig:
    """Return the configuration with the best start for nominals. Raises ModelError, RecordingError."""
    return starts(config, records)[0]


def started_in_response(config: RigConfig, records: Sequence[Recorded]) -> RigConfig:
    """Return the configuration with the best start by frequency response, whatever is measured.

    It costs more than the weak form, but none of many elements runs away, nor is any negative. Without forces
    or with dry friction there is no such response: by weak form then. Raises ModelError, RecordingError.
    """
    model = mechanics(config)
    if not model.forces or model.structure.frictions:
        return started(config, records)
    theta = _from_response(config, model, pieces_of(records), noise_of_sensors(config, records))[0]
    return _with_starts(config, model, theta)


def starts(config: RigConfig, records: Sequence[Recorded]) -> list[RigConfig]:
    """Return the configuration with each start for nominals, the best first; others explain nearly as much.

    Raises ModelError, RecordingError.
    """
    model = mechanics(config)
    sigma = noise_of_sensors(config, records)
    pieces = pieces_of(records)
    _require_motion(model, pieces, sigma)
    begin = _from_response if hidden(model)[0] else _from_weak_form
    return [_with_starts(config, model, theta) for theta in begin(config, model, pieces, sigma)]


def _with_starts(config: RigConfig, model: MassSpringDamper, theta: FloatArray) -> RigConfig:
    return with_nominals(config, _positive(config, dict(zip(model.parameters, theta.tolist(), strict=True))))


def _from_weak_form(
    config: RigConfig, model: MassSpringDamper, pieces: Sequence[tuple[FloatArray, FloatArray]],
    sigma: FloatArray,
) -> list[FloatArray]:  # fmt: skip
    found = start(
        model, pieces, 1.0 / config.rig.sample_rate_hz, sigma,
        straight=straight(config.estimator.hold) == "first", standing=any(c.bias for c in config.channel),
    )  # fmt: skip
    return [found]


def _from_response(
    config: RigConfig, model: MassSpringDamper, pieces: Sequence[tuple[FloatArray, FloatArray]],
    sigma: FloatArray,
) -> list[FloatArray]:  # fmt: skip
    hold = straight(config.estimator.hold)
    period_s = 1.0 / config.rig.sample_rate_hz
    seen = measured(pieces, period_s, sigma, straight=hold == "first")
    if not len(seen.omega):
        advice = "record longer, or with more force; or measure the displacements that are missing"
        raise RecordingError.at("", "no motion answers the measured forces", advice)
    minima = refined(
        model, pieces, period_s, sigma, fitted(model, seen), fastest=float(seen.omega[-1]), hold=hold
    )
    # damping is seen less well and tells no two apart
    telling = np.array([config.parameters[name].kind != "damper" for name in model.parameters], dtype=bool)
    return [minimum.theta for minimum in (minima[0], *others_near(minima, telling))]


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
    return {name: max(value, LEAST_START * largest[kinds[name]]) for name, value in values.items()}


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
