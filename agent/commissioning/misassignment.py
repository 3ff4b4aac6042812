"""Channels that look swapped, reversed, mis-scaled or late: what the model makes of a recording, in words."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from agent.blocks.rig_model import rig_model
from agent.blocks.statistical_rig import statistical_rig
from agent.commissioning.channel_checks import plain_findings, suspicion
from agent.commissioning.numerics.channel_constants import ChannelConstants, WrongConstant
from agent.commissioning.numerics.wiring import Examiner, Finding, Hypothesis
from agent.commissioning.tuning import PLAINER, STRETCHES
from agent.config import RigConfig
from agent.config.model.tables import Channel
from agent.errors import Fault
from agent.runtime.assembly.acquisition_plan import (
    channels_of,
    complete_inputs,
    fitted_model,
    stretch_samples,
)
from agent.text import number
from agent.types import FloatArray

ELASTIC = ("spring", "damper", "friction", "linear")
Progress = Callable[[str], None]


def findings(
    config: RigConfig, v: FloatArray, pieces: Sequence[tuple[int, int]], progress: Progress
) -> list[dict[str, Any]]:
    """Return suspicions of readings v (N, c), inputs first, with uninterrupted pieces as (first, end) rows.

    What is plain without a model comes first. Of the rest one fault at a time: two that spoil each other's
    explanation are found one after the other, if at all.
    """
    stretches = [v[first:end] for first, end in _liveliest(config, v, pieces)]
    if not stretches:
        return []

    def said(done: int, everything: int) -> None:
        progress(f"examining channels: {done} of {everything} explanations")

    if plain := plain_findings(config, v):
        return plain
    finding = _examiner(config, said).examine(stretches)
    mistaken = _mistaken(config, stretches[0])
    # a scale or a sign is a gain as well: the plainer word wins unless it leaves far more
    plainer = finding is not None and not (mistaken and PLAINER * mistaken[0]["left_after"] < finding.after)
    return [_row(config, finding)] if finding is not None and plainer else mistaken


def _mistaken(config: RigConfig, v: FloatArray) -> list[dict[str, Any]]:
    """Return the channel whose one constant, left free, explains readings v (N, c), inputs first, and how."""
    examiner = _examiner(config, lambda _done, _all: None)
    asked = ChannelConstants(examiner.rig, examiner.inputs, examiner.complete)
    before, found = asked.find(v)
    if not found:
        return []
    first = found[0]
    channels = channels_of(config)
    said = "; or ".join(
        _asked_words(one, channels[one.channel], one.channel < examiner.inputs) for one in found
    )
    factor = first.size if first.kind == "scale" else None
    row = suspicion(first.kind, [channels[first.channel].name], said, factor)
    return [row | {"left_before": before, "left_after": first.left}]


def _asked_words(asked: WrongConstant, channel: Channel, drives: bool) -> str:
    """Return how a channel is wrong, and what to do about it."""
    name = channel.name
    if asked.kind == "offset":
        where = f"{number(abs(asked.size), 3)} {channel.si_unit} too {'high' if asked.size > 0 else 'low'}"
        return (
            f"{name} reads {where}, as if never zeroed: "
            "zero it, correct its offset, or set bias = true on that channel"
        )
    if asked.kind == "delay":
        late = "late" if asked.size > 0 else "early"
        whose = "that channel" if asked.size > 0 else "the others"
        size = number(1e3 * abs(asked.size), 3)
        return (
            f"{name} comes {size} ms {late} against the other channels: state that under delay_s of {whose}"
        )
    if not drives:
        return f"{name} reads {number(asked.size, 3)} times what moves there: correct its scale"
    other = number(1.0 / asked.size, 3)
    return (
        f"{name} reads {number(asked.size, 3)} times what the motion asks for, "
        f"or all that moves reads {other} times what it should: correct the scale that is wrong"
    )


def _examiner(config: RigConfig, progress: Callable[[int, int], None]) -> Examiner:
    resolution = np.zeros(len(config.outputs))
    elastic = np.array([p.kind in ELASTIC for p in rig_model(config).parameters])
    fitted = fitted_model(config, resolution, statistical_rig(config).lower)
    return Examiner(fitted, len(config.inputs), elastic, complete_inputs(config, resolution), progress)


def _liveliest(config: RigConfig, v: FloatArray, pieces: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the stretches in which the outputs move most, at most two."""
    length = stretch_samples(config)[1]
    inputs = len(config.inputs)
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
    every = (
        f", or all of {', '.join(outputs)}"
        if hypothesis.channels[0] < inputs == 1 and len(outputs) > 1
        else ""
    )
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
