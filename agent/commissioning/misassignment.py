"""Channels that look swapped, turned round, mis-scaled or late: what the model makes of a recording, in words."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from agent.blocks.advice import words
from agent.blocks.rig_model import hop_plan, known_noise, observer_gains, rig_model, window_settings
from agent.commissioning.channel_checks import plain_findings, suspicion
from agent.config import RigConfig
from agent.config.tables import Channel
from agent.errors import Fault
from agent.numerics.estimator.calibrate import ROUND_OFF
from agent.numerics.estimator.window_settings import WindowSettings
from agent.numerics.faults.suspects import Accusation
from agent.numerics.faults.suspicion import Examiner, Finding, Hypothesis
from agent.numerics.fitting.fit import Problem
from agent.numerics.fitting.guarded import sized
from agent.numerics.fitting.noise import sensor_noise
from agent.numerics.model.observer import Noise
from agent.numerics.model.statespace import Discrete, Model, discretise
from agent.runtime.acquisition_plan import channels_of, complete_inputs, stretch_samples
from agent.text import number
from agent.types import FloatArray

STRETCHES = 2
ELASTIC = ("spring", "damper", "friction", "linear")
KINDS = {"bias": "offset", "gain": "scale", "input gain": "scale"}
"""What is found in a window, by the names that a check gives it."""
Progress = Callable[[str], None]


def findings(
    config: RigConfig, v: FloatArray, pieces: Sequence[tuple[int, int]], progress: Progress
) -> list[dict[str, Any]]:
    """Return what is suspected of readings v (N, c), inputs first, with uninterrupted pieces as (first, end) rows.

    What is plain without a model comes first. Of the rest one fault at a time: two that spoil each other's explanation
    are found one after the other, if at all.
    """
    stretches = [v[first:end] for first, end in _liveliest(config, v, pieces)]
    if not stretches:
        return []

    def said(done: int, everything: int) -> None:
        progress(f"examining channels: {done} of {everything} explanations")

    if plain := plain_findings(config, v):
        return plain
    finding = _examiner(config, said).examine(stretches)
    return _mistaken(config, stretches[0]) if finding is None else [_row(config, finding)]


def _mistaken(config: RigConfig, v: FloatArray) -> list[dict[str, Any]]:
    """Return the channels that `replay` would condemn too, of readings v (N, c), inputs first."""
    rig, resolution, inputs = rig_model(config), np.zeros(len(config.outputs)), len(config.inputs)
    settings = window_settings(config, rig, resolution)
    y, u = v[:, inputs:], v[:, :inputs]
    columns = np.hstack([y, complete_inputs(config, resolution)(y, u)])
    guess = np.maximum(sensor_noise(y), ROUND_OFF * np.abs(y).max(axis=0) + 1e-300)
    # what is stated is the sensor's; its wire adds to that
    noise = Noise(np.fmax(settings.sigma, guess), np.zeros(rig.disturbance.shape[1]))
    stages = [lambda at: settings.gains.start(at, noise), lambda at: settings.gains.settled(at, noise)]
    scale = sized(settings.scale, settings.scale_column, columns)
    problem = Problem(lambda theta: _sampled(rig.model, theta, settings), columns, scale, settings.lower)
    mistakes = settings.mistakes
    found = None if mistakes is None else mistakes.find(problem, rig.model.nominal, stages, noise.sigma)
    # a gain or a delay that leaves more than noise may as well be something else that the model lacks
    if found is None or not (found.whole or found.suspect.kind == "bias"):
        return []
    # the model's outputs come first in what is found, its inputs in the configuration
    channels = [*config.outputs, *config.inputs]
    accusation = Accusation(found.suspect, found.share, sizes=found.sizes)
    said = words(accusation, [(channel.name, channel.si_unit) for channel in channels])
    kind = KINDS.get(found.suspect.kind, found.suspect.kind)
    factor = found.sizes[0] if kind == "scale" else None
    return [suspicion(kind, [channels[r].name for r in found.suspect.channels], said, factor)]



def _sampled(model: Model, theta: FloatArray, settings: WindowSettings) -> Discrete:
    """Return a rig's sampled model at theta (q,)."""
    return discretise(model.continuous(theta), settings.period_s, settings.hold)


def _examiner(config: RigConfig, progress: Callable[[int, int], None]) -> Examiner:
    rig, resolution = rig_model(config), np.zeros(len(config.outputs))
    settings = window_settings(config, rig, resolution)
    return Examiner(
        model=rig.model, inputs=len(config.inputs), period_s=settings.period_s, hold=config.estimator.hold,
        gains=observer_gains(config, rig, hop_plan(config).window), sigma=known_noise(config, resolution),
        scale=settings.scale, scale_column=settings.scale_column, lower=settings.lower,
        elastic=np.array([p.kind in ELASTIC for p in rig.parameters]),
        complete=complete_inputs(config, resolution), progress=progress,
    )  # fmt: skip


def _liveliest(config: RigConfig, v: FloatArray, pieces: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the stretches in which the outputs move most, at most two."""
    length, inputs = stretch_samples(config)[1], len(config.inputs)
    size = np.maximum(v[:, inputs:].std(axis=0), 1e-300)
    found = [(a, a + length) for first, end in pieces for a in range(first, end - length + 1, length)]
    if not found:
        found = [(first, end) for first, end in pieces if end - first >= stretch_samples(config)[0]]

    def moved(stretch: tuple[int, int]) -> float:
        return float(np.sum(v[slice(*stretch), inputs:].std(axis=0) / size))

    return sorted(sorted(found, key=moved, reverse=True)[:STRETCHES])


def _row(config: RigConfig, finding: Finding) -> dict[str, Any]:
    channels = channels_of(config)
    words = [_words(hypothesis, channels, len(config.inputs)) for hypothesis in finding.explanations]
    first = finding.explanations[0]
    return {
        "kind": first.kind, "channels": [channels[c].name for c in first.channels],
        "factor": first.factor if first.kind == "scale" else None,
        "left_before": finding.before, "left_after": finding.after,
        "words": "; or ".join(dict.fromkeys(words)) + _how_sure(finding),
    }  # fmt: skip


def _how_sure(finding: Finding) -> str:
    before, after = number(100 * finding.before, 3), number(100 * finding.after, 3)
    return f" (leaves {after} % of the motion unexplained instead of {before} %)"


def _words(hypothesis: Hypothesis, channels: Sequence[Channel], inputs: int) -> str:
    names = [channels[c].name for c in hypothesis.channels]
    if hypothesis.kind == "swap":
        return f"{names[0]} and {names[1]} look swapped"
    outputs = [channel.name for channel in channels[inputs:]]
    every = f", or all of {', '.join(outputs)}" if hypothesis.channels[0] < inputs == 1 and len(outputs) > 1 else ""
    if hypothesis.kind == "sign":
        return f"{names[0]} looks turned round (its sign is wrong){every and every + ' do'}"
    much, far = _times(hypothesis.factor)
    other = f"{every} {_times(1 / hypothesis.factor)[0]}" if every else ""
    return f"{names[0]} looks {much}{other}{_unit(channels[hypothesis.channels[0]], far)}"


def _times(factor: float) -> tuple[str, float]:
    large = factor > 1
    times = factor if large else 1 / factor
    return f"{times:.6g} times too {'large' if large else 'small'}", times


def _unit(channel: Channel, times: float) -> str:
    """What makes such a factor, where a unit does."""
    if channel.quantity in ("input", "output"):
        return ""
    inch = {25.4: "inches against mm", 39.3700787: "inches against m"}
    known = {
        1000.0: "a prefix: mm against m, kN against N", 1e6: "a prefix: um against m", 100.0: "cm against m",
        9.80665: "kilograms of force against N, or g against m/s2", 4.4482216: "pounds of force against N",
    } | inch  # fmt: skip
    return f": {known[times]}?" if times in known else ""


def warnings_of(config: RigConfig, rows: Sequence[dict[str, Any]]) -> list[Fault]:
    """Return a warning for each suspicion, at the channel's key path."""
    places = {channel.name: number for number, channel in enumerate(config.channel)}
    advice = "look at the wiring, and at unit, scale and map"
    return [Fault(f"channel[{places[row['channels'][0]]}]", row["words"], advice) for row in rows]
