"""Windows of recordings: how long they are, and what all of them say together."""

from collections.abc import Sequence
from dataclasses import replace
from math import pi

import numpy as np

from agent.blocks.rig_model import rig_model
from agent.blocks.statistical_rig import estimator_settings, statistical_rig
from agent.commissioning.explained import windows_of
from agent.commissioning.identification.material import no_piece, noise_of_sensors
from agent.commissioning.numerics.motion.pooled import Pooled, pooled
from agent.commissioning.progress import Progress
from agent.commissioning.readings import Recorded
from agent.commissioning.tuning import (
    AT_ONCE,
    FIRST_PERIODS,
    LONGEST,
    PERIODS,
    SHORTEST_PIECE,
    WINDOWS,
)
from agent.config import RigConfig
from agent.numerics.estimator.settings import EstimatorSettings
from agent.numerics.inference.spectral.columns import Window, window_of
from agent.numerics.inference.tuning import SIGMA_SPREAD_UNSTATED
from agent.numerics.model.holds import straight
from agent.numerics.model.sensors import with_constant
from agent.types import ComplexArray


def poles_of(config: RigConfig) -> ComplexArray:
    """Return the poles at nominal (n,), rad/s."""
    model = rig_model(config).model
    at = model.continuous(model.nominal)
    poles: ComplexArray = np.asarray(np.linalg.eigvals(at.A), dtype=np.complex128)
    if at.is_sampled:
        rate = np.log(np.where(poles == 0, AT_ONCE + 0j, poles)) * config.rig.sample_rate_hz
        return np.asarray(rate, dtype=np.complex128)
    return poles


def first_window_length(config: RigConfig) -> int:
    """Return the length of a linear model's first windows, samples: periods of the fastest oscillation."""
    poles = poles_of(config)
    rate = config.rig.sample_rate_hz
    oscillating = np.abs(poles[(np.abs(poles.imag) > np.abs(poles.real)) & (np.abs(poles) < pi * rate / 2)])
    period_s = 2 * pi / oscillating.max() if len(oscillating) else slowest_period_s(config)
    return int(np.clip(FIRST_PERIODS * period_s * rate, SHORTEST_PIECE, LONGEST))


def slowest_period_s(config: RigConfig) -> float:
    """Return the period of the slowest mode at nominal, s."""
    speeds = np.abs(poles_of(config))
    return float(2 * pi / np.min(speeds[speeds > 1e-6 * speeds.max()], initial=speeds.max()))


def window_length(config: RigConfig, records: Sequence[Recorded]) -> int:
    """Return the length of the windows that are joined, samples: some periods of the slowest mode."""
    lengths = [b - a for record in records for a, b in record.pieces]
    if max(lengths, default=0) < SHORTEST_PIECE:
        raise no_piece()
    wanted = max(
        PERIODS * slowest_period_s(config) * config.rig.sample_rate_hz, sum(lengths) / WINDOWS, SHORTEST_PIECE
    )
    longest = max(lengths)
    # equal parts of the longest piece: a remainder would be lost
    return min(longest // max(1, int(longest / wanted)), LONGEST)


def pool(
    begun: RigConfig, records: Sequence[Recorded], window: int, progress: Progress
) -> tuple[Pooled, RigConfig, int]:  # fmt: skip
    """Join all windows of so many samples; return what they say, the configuration used, and their number."""
    config, settings, windows = windowed(begun, records, window)
    noise = noise_of_sensors(config, records)
    known = np.isfinite(settings.sigma)
    sigma = np.where(known, settings.sigma, noise)
    spread = np.where(known, settings.sigma_spread, SIGMA_SPREAD_UNSTATED)
    # far from the machine a model may grow beyond all numbers within a window, or die within a sample
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        said = pooled(settings.rig, windows, sigma, spread, settings.floor, settings.wire, progress)
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
    settings = replace(settings, rig=statistical_rig(config))  # springs are straight until they are watched
    columns = len(settings.rig.measured)
    windows = []
    for record in records:
        u = with_constant(record.u, columns)
        for a, b in windows_of(record, window):
            windows.append(window_of(record.y[a:b], u[a:b], u[a - 1] if a else None))
    return config, settings, windows
