"""Standard deviations to expect of a rig's windows: the Cramer-Rao bound under an excitation."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from agent.blocks.friction import friction_inputs, signals
from agent.blocks.rig_model import RigModel, hop_plan, longer_windows, output_noise
from agent.blocks.statistical_rig import statistical_rig
from agent.commissioning import tuning
from agent.commissioning.numerics.information import PredictedSd, predicted_sd
from agent.commissioning.readings import Recorded
from agent.config import RigConfig
from agent.numerics.fitting.tuning import GREATEST
from agent.numerics.model.holds import straight
from agent.numerics.model.sensors import with_constant
from agent.numerics.model.statespace import Discrete, discretise, simulate
from agent.numerics.model.uncertain import Rig
from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class Excitation:
    """What moves the rig.

    Attributes:
        u: (N, m) inputs.
        starts: window length -> samples at which windows may begin.
        state: the state (n,) at the start of a window: (first sample, length) -> x.
        rms: (p,) of the outputs.
        words: for people.
    """

    u: FloatArray
    starts: Callable[[int], Sequence[int]]
    state: Callable[[int, int], FloatArray]
    rms: FloatArray
    words: str


@dataclass(frozen=True, slots=True)
class Prediction:
    """The sds to expect of every parameter, (q,), from a window of that length under what is assumed.

    sd: against nominal, the constants known as their data sheets say; sd_repeat: against another window of
    the rig.
    """

    window: int
    sd: FloatArray
    sd_repeat: FloatArray
    assumes: str


def sampled(config: RigConfig, rig: RigModel) -> Discrete:
    """Return the nominal model as the estimator samples it, save a polynomial hold, which differs little."""
    continuous = rig.model.continuous(rig.model.nominal)
    return discretise(continuous, 1.0 / config.rig.sample_rate_hz, straight(config.estimator.hold))


def windows(config: RigConfig) -> list[int]:
    """Return the lengths of a rig's windows, samples, shortest first, as the estimator takes them."""
    plan = hop_plan(config)
    return [plan.window, *longer_windows(config, plan)]


def predictions(
    config: RigConfig, rig: RigModel, resolution: FloatArray, recorded: Recorded | None
) -> list[Prediction]:
    """Predict for each window; resolution (p,) is the wire's smallest step of each output, SI."""
    discrete = sampled(config, rig)
    lengths = windows(config)
    excitation = (
        recorded_excitation(discrete, recorded)
        if recorded
        else assumed_excitation(config, discrete, rig, max(lengths))
    )
    sigma, noise_words = expected_noise(config, resolution, excitation, recorded)
    # the excitation is of straight lines, which is near enough for an sd
    statistical = replace(statistical_rig(config), hold=straight(config.estimator.hold))
    words = "; ".join([excitation.words, noise_words, *_constants(statistical)])
    found = [_expected(discrete, statistical, excitation, sigma, length) for length in lengths]
    return [
        Prediction(length, one.sd, one.sd_repeat, words) for length, one in zip(lengths, found, strict=True)
    ]


def _constants(rig: Rig) -> list[str]:
    """Say that the constants are taken as their data sheets state them, where there are any."""
    return ["masses, gains and the delay as well known as stated"] if rig.constants else []


def _expected(
    discrete: Discrete, rig: Rig, excitation: Excitation, sigma: FloatArray, window: int
) -> PredictedSd:
    """Return the medians over the windows of an excitation; NaN where none fits into it."""
    found = []
    for start in excitation.starts(window):
        u = excitation.u[start : start + window]
        # the learner's state is the shifted one
        x0 = excitation.state(start, window) - discrete.B1 @ u[0]
        found.append(predicted_sd(rig, x0, u, sigma))
    if not found:
        nothing = np.full(discrete.model.q, np.nan)
        return PredictedSd(nothing, nothing, nothing)
    return PredictedSd(
        np.asarray(np.median([one.sd for one in found], axis=0)),
        np.asarray(np.median([one.sd_repeat for one in found], axis=0)),
        np.asarray(np.median([one.scatter for one in found], axis=0)),
    )


def assumed_excitation(config: RigConfig, discrete: Discrete, rig: RigModel, longest: int) -> Excitation:
    """Return what moves a rig without a recording: a white force, or a free decay where nothing drives it."""
    if not config.inputs:
        return _decay(config, discrete, rig, longest)
    rng = np.random.default_rng(0)
    settle = _settling(discrete, longest)
    count = settle + longest + min(8 * longest, tuning.SPAN_MOST)
    if _growth(discrete, count) > GREATEST:
        # of a model that leaves the numbers its first window is all there is, if that
        settle, count = 0, longest
    if _growth(discrete, count) > tuning.MOST_GROWN:
        nothing = np.zeros((0, discrete.model.m))
        words = "nothing: the model grows beyond all that is measured within a window"
        return Excitation(nothing, lambda _: [], lambda *_: nothing[0], np.ones(discrete.model.p), words)
    u = tuning.FORCE_RMS * rng.standard_normal((count, len(config.inputs)))
    u = completed(config, discrete, np.zeros(discrete.model.n), u)
    x, y = simulate(discrete, np.zeros(discrete.model.n), u)
    inputs = " and ".join(f"{tuning.FORCE_RMS:g} {channel.si_unit} rms" for channel in config.inputs)
    kind = "force" if config.inputs[0].quantity == "force" else "input"
    return Excitation(
        u, lambda window: _spread(settle, count - window, window), lambda start, _: x[start],
        _rms(y[settle:]),
        f"white {kind} of {inputs}",
    )  # fmt: skip


def _growth(discrete: Discrete, count: int) -> float:
    """Return how many times as large so many samples make a motion of an unstable model; 1 of others."""
    radius = float(np.abs(np.linalg.eigvals(discrete.model.A)).max(initial=0.0))
    return float(10.0 ** min(count * np.log10(max(radius, 1.0)), 300.0))


def _decay(config: RigConfig, discrete: Discrete, rig: RigModel, longest: int) -> Excitation:
    names = rig.model.state_names
    x0 = np.array([0.0 if name.startswith("velocity") else tuning.DECAY_FROM for name in names])
    u = completed(config, discrete, x0, np.zeros((longest, 0)))
    _, y = simulate(discrete, x0, u)
    unit = "m" if names[-1].startswith("displacement") else "in every state"
    words = f"free decay from {tuning.DECAY_FROM:g} {unit}, first window"
    return Excitation(u, lambda _: [0], lambda *_: x0, _rms(y), words)


def completed(config: RigConfig, discrete: Discrete, x0: FloatArray, u: FloatArray) -> FloatArray:
    """Put the signs of dry friction, of the motion without it, and the constant 1 beside inputs (N, m)."""
    friction = friction_inputs(config, np.zeros(discrete.model.p))
    if friction is not None:
        still = np.hstack([u, np.zeros((len(u), signals(config) - u.shape[1]))])
        _, y = simulate(discrete, x0, with_constant(still, discrete.model.m))
        u = friction.beside(y, u)
    return with_constant(u, discrete.model.m)


def recorded_excitation(discrete: Discrete, recorded: Recorded) -> Excitation:
    """Let the recorded force move the nominal model, in each window from the state that its readings show."""

    def starts(window: int) -> list[int]:
        found = [_spread(a, b - window, window) for a, b in recorded.pieces]
        return [start for piece in found for start in piece]

    def state(start: int, window: int) -> FloatArray:
        return recorded.first_state(discrete, start, start + window)

    u = with_constant(recorded.u, discrete.model.m)
    return Excitation(
        u, starts, state, _rms(recorded.y), f"the excitation of {recorded.name}, no disturbance beside it"
    )


def _rms(signal: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(signal**2, axis=0)))


def _settling(discrete: Discrete, window: int) -> int:
    """Samples until the slowest mode that decays has settled, within reason."""
    radius = np.abs(np.linalg.eigvals(discrete.model.A))
    decaying = radius[radius < 1 - 1e-9]
    slowest = -1.0 / np.log(max(float(decaying.max(initial=0.0)), 1e-12))
    return int(np.clip(5 * slowest, window, tuning.SETTLE_MOST))


def _spread(first: int, last: int, window: int) -> list[int]:
    """Return window starts from first to last, both included; fewer for long windows."""
    if last < first:
        return []
    wanted = int(np.clip(20_000 // window, 3, 25))
    return sorted({round(place) for place in np.linspace(first, last, wanted).tolist()})


def expected_noise(
    config: RigConfig, resolution: FloatArray, excitation: Excitation, recorded: Recorded | None
) -> tuple[FloatArray, str]:
    """Return sigma (p,) and how it was come by, the same words for all outputs that share a way."""
    stated, floor = output_noise(config, resolution)
    sigma = stated.copy()
    ways = {}
    for r in np.flatnonzero(~np.isfinite(stated)):
        seen = recorded.noise[r] if recorded is not None else 0.0
        sigma[r], ways[config.outputs[r].name] = _guess(
            float(seen), float(floor[r]), float(excitation.rms[r])
        )
    known = [c.name for c in config.outputs if c.name not in ways]
    return sigma, "; ".join(_way(list(ways), ways, known))


def _guess(seen: float, floor: float, rms: float) -> tuple[float, str]:
    if seen > floor:
        return seen, "noise as the recording shows it"
    if floor > 0:
        return floor, "noise not known, so no more than the wire's resolution"
    return max(
        tuning.GUESSED_NOISE * rms, 1e-300
    ), f"noise not known, taken as {tuning.GUESSED_NOISE:.1%} of the signal"


def _way(names: list[str], ways: Mapping[str, str], known: list[str]) -> list[str]:
    said = [f"noise of {', '.join(known)} as configured"] if known and names else []
    if not names:
        return ["noise as configured"]
    return said + [
        f"{', '.join(n for n in names if ways[n] == way)}: {way}" for way in dict.fromkeys(ways.values())
    ]


def rows(predicted: Sequence[Prediction], config: RigConfig, rig: RigModel) -> list[dict[str, Any]]:
    """Return the rows of the document's `predicted_sd`."""
    rate = config.rig.sample_rate_hz
    return [
        {
            "window_s": found.window / rate, "parameter": parameter.name, "sd": sd, "sd_repeat": repeat,
            "unit": parameter.unit, "assumes": found.assumes,
        }
        for found in predicted
        for parameter, sd, repeat in zip(
            rig.parameters, found.sd.tolist(), found.sd_repeat.tolist(), strict=True
        )
    ]  # fmt: skip
