"""What `deltak check` warns of: nothing that stops the agent, all that may disappoint."""

from collections.abc import Iterator, Sequence
from math import inf, isfinite, pi

import numpy as np

from agent.blocks.rig_model import RigModel
from agent.commissioning.prediction import Prediction, sampled, windows
from agent.commissioning.readings import Recorded
from agent.commissioning.tuning import FEW_A_PERIOD, FEWER_A_PERIOD, LIVELY, MARGINAL
from agent.config import RigConfig
from agent.config.reading.units import near_miss
from agent.errors import Fault
from agent.numerics.model.statespace import modes
from agent.runtime.sources import source_hints, unordered_sources
from agent.text import behind, counted


def warnings(
    config: RigConfig, rig: RigModel, predicted: Sequence[Prediction], recorded: Recorded | None
) -> list[Fault]:
    """Return every warning: key path, what, advice."""
    return [
        *_poles(config, rig),
        *_windows(config, rig),
        *_predicted(config, rig, predicted, recorded),
        *_delays(config),
        *_observer(config),
        *_noise(config),
        *_units(config),
        *_sources(config),
        *_clocks(config),
        *_recorded(recorded),
    ]


def _poles(config: RigConfig, rig: RigModel) -> Iterator[Fault]:
    radii = np.abs(np.linalg.eigvals(sampled(config, rig).model.A))
    if np.any(radii > 1 + 1e-6):
        yield Fault(
            "model", "the nominal model is unstable: a motion grows by itself", "look at signs and values"
        )
    elif np.any(radii > 1 - MARGINAL):
        what = (
            "the nominal model has a motion that does not decay: a mass that nothing holds or nothing damps"
        )
        yield Fault(
            "model", what, "the observer keeps correcting it, which costs information; add what holds it"
        )


def _modes(config: RigConfig, rig: RigModel) -> list[complex]:
    """Poles in the upper half plane that oscillate."""
    poles = modes(rig.model.continuous(rig.model.nominal), 1.0 / config.rig.sample_rate_hz)
    return [complex(pole) for pole in poles if pole.imag > LIVELY * abs(pole)]


def _windows(config: RigConfig, rig: RigModel) -> Iterator[Fault]:
    rate = config.rig.sample_rate_hz
    frequencies = [pole.imag / (2 * pi) for pole in _modes(config, rig)]
    longest = windows(config)[-1] / rate
    slowest = min(frequencies, default=inf)
    fastest = max(frequencies, default=0.0)
    if longest * slowest < 1:
        what = f"{longest:g} s is shorter than a period of the slowest mode, {1 / slowest:.3g} s"
        yield Fault(
            "estimator.window_s", what, "a longer window tells far more of the parameters behind that mode"
        )
    if fastest > rate / 2:
        what = f"{rate:g} Hz does not show the mode at {fastest:.4g} Hz"
        yield Fault(
            "rig.sample_rate_hz", what, f"sample above {2 * fastest:.4g} Hz, better ten times the mode"
        )
    elif fastest > rate / FEW_A_PERIOD:
        what = f"{rate:g} Hz are few samples a period of the mode at {fastest:.4g} Hz: {rate / fastest:.3g}"
        hold = "cubic" if fastest < rate / FEWER_A_PERIOD else "quintic"
        smoother = f', or hold = "{hold}" where the force is smooth between samples' if config.inputs else ""
        advice = f"{FEW_A_PERIOD * fastest:.4g} Hz would do{smoother}"
        yield Fault("rig.sample_rate_hz", what, advice)


def _predicted(
    config: RigConfig, rig: RigModel, predicted: Sequence[Prediction], recorded: Recorded | None
) -> Iterator[Fault]:
    """Warn where no window is expected to tell a parameter well enough, with what would mend it."""
    rate = config.rig.sample_rate_hz
    if not predicted:
        return
    sds = np.array([prediction.sd for prediction in predicted])
    best = np.argmin(np.where(np.isfinite(sds), sds, inf), axis=0)
    for i, (parameter, limit) in enumerate(zip(rig.parameters, rig.limits.tolist(), strict=True)):
        prediction = predicted[best[i]]
        sd = float(prediction.sd[i])
        enough = config.estimator.resolve * limit
        if limit > 0 and isfinite(sd) and sd > enough:
            window_s = prediction.window / rate
            what = f"{window_s:g} s tell {parameter.name} to ± {sd:.2g}{behind(parameter.unit)}, more than "
            what += f"resolve x limit = {enough:.2g} ({prediction.assumes})"
            yield Fault("estimator.window_s", what, _remedy(config, sd / enough, window_s))
    if recorded is not None and not np.isfinite(sds).all(axis=1).any():
        what = f"{recorded.name} has no uninterrupted {predicted[0].window / rate:g} s, or no motion in them"
        yield Fault("estimator.window_s", what, "give a longer recording")


def _remedy(config: RigConfig, factor: float, window_s: float) -> str:
    """A window tells at least by the square root of its length; a force in proportion."""
    longer = f"a window of {window_s * factor**2:.2g} s"
    drives = "force" if any(channel.quantity == "force" for channel in config.inputs) else "input"
    force = f"{factor:.2g} times the {drives if config.inputs else 'motion'}"
    return f"{longer}, {force}, or less noise would do; until then rows say unexcited"


def _delays(config: RigConfig) -> Iterator[Fault]:
    longest = max(config.estimator.windows_s, default=0.0)
    for number, alarm in enumerate(config.alarm):
        if alarm.on_delay_s is not None and alarm.on_delay_s < 0.5 * longest:
            what = f"{alarm.on_delay_s:g} s is less than half a window, {0.5 * longest:g} s"
            advice = "windows that straddle a change may name a wrong parameter"
            yield Fault(f"alarm[{number}].on_delay_s", what, advice)


def _observer(config: RigConfig) -> Iterator[Fault]:
    gain = config.estimator.observer.gain
    denies_forces = config.estimator.observer.process_sd == 0
    if config.estimator.method == "window-ml" and gain != "auto" and not denies_forces:
        what = (
            f'gain = "{gain}" changes nothing: '
            'with method = "window-ml" the estimates are the same under every gain'
        )
        yield Fault("estimator.observer", what, 'remove it, or take method = "seed", which is made of it')


def _noise(config: RigConfig) -> Iterator[Fault]:
    for number, channel in enumerate(config.channel):
        if not channel.is_input and channel.noise_sd is None:
            what = f"{channel.name}: noise_sd is not given"
            advice = (
                "it is learnt from the first window that fits, "
                "which must not be one in which something changes"
            )
            yield Fault(f"channel[{number}]", what, advice)


def _units(config: RigConfig) -> Iterator[Fault]:
    """Warn of units that are none but look like one: they are kept as text and carried into parameters."""
    for number, channel in enumerate(config.channel):
        if meant := near_miss(channel.quantity, channel.unit):
            what = f'{channel.name}: "{channel.unit}" is no unit that is known; it is kept as it is'
            yield Fault(
                f"channel[{number}].unit",
                what,
                f"is {meant} meant? Parameters would come out in another unit",
            )


def _sources(config: RigConfig) -> Iterator[Fault]:
    if not config.source:
        yield Fault("source", "there is none", "replay works; run needs one")
    for number, hint in source_hints(config):
        what, _, advice = hint.partition("; ")
        yield Fault(f"source[{number}]", what, advice)


def _clocks(config: RigConfig) -> Iterator[Fault]:
    """Warn where a source has nothing of what the rig's clock orders samples by."""
    misses = "no counter" if config.rig.clock == "counter" else "no time stamps"
    for number in unordered_sources(config):
        what = (
            f'{config.source[number].name} has {misses}, but clock = "{config.rig.clock}": '
            "lost samples are not seen"
        )
        yield Fault(f"source[{number}]", what, 'name its counter, or set clock = "arrival"')


def _recorded(recorded: Recorded | None) -> Iterator[Fault]:
    if recorded is not None and recorded.facts["gaps"]:
        gaps = counted(recorded.facts["gaps"], "gap")
        what = f"{recorded.name} has {gaps}, {counted(recorded.facts['missing'], 'sample')} missing"
        yield Fault("", what, "each gap costs the windows that it falls into")
