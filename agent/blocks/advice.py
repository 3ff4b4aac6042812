"""Advisory of the model: what it was found to lack, and what to do about it, in words."""

from collections.abc import Iterable, Sequence

import numpy as np

from agent.numerics.faults.suspects import Accusation, ChannelSuspect, Suspect
from agent.numerics.model.mechanics import GROUND
from agent.text import number, percent
from agent.types import EstimateBatch, HealthEvent, Reason

SOURCE = "model"
AGAIN_S = 3600.0


class ModelAdvice:
    """Says what the model of one rig lacks, each thing at most once an hour of samples.

    Args:
        rig: its name.
        rate_hz: samples a second.
        channels: name and SI unit of each output, then of each input.
    """

    def __init__(self, rig: str, rate_hz: float, channels: Sequence[tuple[str, str]] = ()) -> None:
        self._rig, self._pause, self._channels = rig, round(AGAIN_S * rate_hz), channels
        self._said: dict[Suspect | ChannelSuspect, int] = {}

    def step(self, findings: Iterable[tuple[int, Accusation]], batch: EstimateBatch) -> list[HealthEvent]:
        """Return events for findings (sample, accusation) that belong to rows of a batch."""
        events: list[HealthEvent] = []
        for sample, found in findings:
            said = self._said.get(found.suspect)
            if said is None or sample - said >= self._pause:
                self._said[found.suspect] = sample
                events.append(self._event(found, int(batch.t_ns[np.searchsorted(batch.index, sample)])))
        return events

    def _event(self, found: Accusation, t_ns: int) -> HealthEvent:
        cause = found.suspect.reason.name.lower().replace("_", " ")
        return HealthEvent(self._rig, SOURCE, t_ns, cause, words(found, self._channels))


def words(found: Accusation, channels: Sequence[tuple[str, str]] = ()) -> str:
    """Return what a model lacks, or what is wrong with channels (name, SI unit), and what to do about it."""
    if isinstance(found.suspect, ChannelSuspect):
        if found.suspect.kind == "stuck":
            return _stuck_words([channels[r] for r in found.suspect.channels], found.sizes)
        return _channel_words(found.suspect, found.sizes, channels)
    node, other = found.suspect.between
    place = node if other == GROUND else f"{node} and {other}"
    if found.suspect.reason is Reason.MASS:
        larger = "larger" if found.change > 0 else "smaller"
        size = percent(found.change) if abs(found.change) < 1.0 else "far"  # found to first order: no more is known
        return (
            f"mass {node} looks {size} {larger} than model.mass says: correct its "
            f'value, or make it a parameter: add "{node}" to estimator.estimate'
        )
    between = f"between {node} and {other}" if other != GROUND else f"at {node}"
    return {
        Reason.DRY_FRICTION: f"what the model leaves looks like dry friction {between}: add it under model.friction",
        Reason.NONLINEAR: f"what the model leaves looks like a spring {between} whose stiffness moves with its stroke: "
        "look for play or a stop, or keep to smaller strokes",
        Reason.BIAS: f"what the model leaves looks like a constant force at {place}: an offset of the force or of a "
        "displacement; set bias = true on that channel",
    }[found.suspect.reason]


def _stuck_words(named: Sequence[tuple[str, str]], stood: Sequence[float]) -> str:
    """Return which channels (name, SI unit) stood where, and what to do about it."""
    each = (f"{name} stood at {number(at, 4)} {unit}" for (name, unit), at in zip(named, stood, strict=True))
    return f"{', '.join(each)} all through a window that no parameters explain: look at that sensor and its wiring"


def _channel_words(suspect: ChannelSuspect, sizes: Sequence[float], channels: Sequence[tuple[str, str]]) -> str:
    """Return how channels are wrong, and what to do about it."""
    named = [channels[r] for r in suspect.channels]
    every = " and ".join(name for name, _ in named)
    if suspect.kind == "forces":
        return _force_words(sizes, every)
    if suspect.kind == "bias":
        reads = " and ".join(
            f"{name} reads {number(abs(size), 3)} {unit} too {'high' if size > 0 else 'low'}"
            for (name, unit), size in zip(named, sizes, strict=True)
        )
        return f"{reads}, as if never zeroed: zero it, correct its offset, or set bias = true on that channel"
    if suspect.kind == "delay":
        late = "late" if sizes[0] > 0 else "early"
        return (
            f"{every} comes {number(1e3 * abs(sizes[0]), 3)} ms {late} against the other channels: state that under "
            f"delay_s of {'that channel' if sizes[0] > 0 else 'the others'}"
        )
    if suspect.kind == "swap":
        return f"{every} look exchanged: exchange them in source.map, or on the terminals"
    if suspect.kind == "sign" or abs(sizes[0] + 1.0) < 0.05:
        return f"{every} looks turned round: give its scale the other sign, or mount it the other way"
    return _scale_words(every, sizes[0], driving=suspect.kind == "input gain")


def _force_words(shares: Sequence[float], resting: str) -> str:
    """Return that unknown forces cause a share of the motion, beside measured ones that perhaps never move."""
    part = f"{number(100 * shares[0], 2)} % of the motion" if shares else "the motion"
    asked = f"the readings ask for unknown forces that cause {part}"
    if resting:
        never = f"while {resting} never moves: look at that sensor and its wiring, or measure the force that acts"
        return f"{asked}, {never}"
    return (
        f"{asked}, beside those that are measured: check zero, sign, scale and delay of every channel, and whether "
        "another force acts"
    )


def _scale_words(name: str, factor: float, *, driving: bool) -> str:
    """Return how many times too large a channel reads; of one that drives only against all that it moves."""
    if driving:
        return (
            f"{name} reads {_times(factor)} times what the motion asks for, or all that moves reads "
            f"{_times(1.0 / factor)} times what it should: correct the scale that is wrong"
        )
    return f"{name} reads {_times(factor)} times what moves there: correct its scale"


def _times(factor: float) -> str:
    """Write a factor to three digits, without an exponent where it is a thousand or so."""
    return number(float(number(factor, 3)))
