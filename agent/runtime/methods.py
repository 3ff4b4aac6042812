"""The estimation methods by the names that configurations use."""

from functools import partial

import numpy as np

from agent.blocks.contained_estimator import ContainedEstimator
from agent.blocks.estimation import Estimation, Estimator, Labels
from agent.blocks.friction import signals
from agent.blocks.rig_model import RigModel, pushed, rig_model, window_settings
from agent.config import RigConfig
from agent.errors import Fault, ModelError
from agent.numerics.estimator.window_ml import WindowML
from agent.numerics.estimator.window_settings import WindowSettings
from agent.numerics.model.observer import Noise
from agent.numerics.model.statespace import discretise
from agent.runtime.model_check import require_observable
from agent.types import FloatArray


def make_estimation(
    config: RigConfig, resolution: FloatArray, input_resolution: FloatArray | None = None
) -> Estimation:
    """Build the estimation block of a rig; resolution (p,) is the wire's smallest step of each output, SI.

    input_resolution (m,) is that of each input; None where readings are exact.

    Raises ModelError where a window has fewer readings than unknowns, or the channels cannot tell what is asked.
    """
    rig = rig_model(config)
    require_observable(config, rig)
    settings = window_settings(config, rig, resolution, input_resolution)
    unknowns = len(rig.model.state_names) + len(rig.parameters)
    readings = settings.plan.window * len(config.outputs)
    if readings <= unknowns:
        shortest = unknowns // max(len(config.outputs), 1) + 1
        raise ModelError(
            [
                Fault(
                    "estimator.window_s",
                    f"a window of {settings.plan.window} samples has {readings} readings for {unknowns} unknowns",
                    f"make it {shortest / config.rig.sample_rate_hz:g} s at the very least",
                )
            ]
        )
    labels = Labels(
        rig=config.rig.name,
        method=config.estimator.method,
        parameters=tuple(p.name for p in rig.parameters),
        units=tuple(p.unit for p in rig.parameters),
        reference=np.array([p.nominal for p in rig.parameters]),
        baseline_id=None,
        window_s=settings.plan.window / config.rig.sample_rate_hz,
        window=settings.plan.window,
        hop=settings.plan.hop,
        least=np.where(np.isfinite(settings.lower), 0.0, -np.inf),
        channels=tuple(c.name for c in (*config.outputs, *config.inputs)),
        pushed=pushed(rig.model),
        channel_units=tuple(c.si_unit for c in (*config.outputs, *config.inputs)),
        rate_hz=config.rig.sample_rate_hz,
        enough_sd=settings.enough_sd,
        windows=(settings.plan.window, *settings.longer) if config.estimator.method == "window-ml" else (),
        longest=max(settings.plan.window, *settings.longer, settings.drift or 0),
        frictions=signals(config) - len(config.inputs),
    )
    several = len(labels.windows) if len(labels.windows) > 1 else 0
    estimator = ContainedEstimator(
        partial(_estimator, config, rig, settings), settings.plan, len(rig.parameters), several
    )
    return Estimation(estimator, labels, estimator.take_failures)


def _estimator(config: RigConfig, rig: RigModel, settings: WindowSettings) -> Estimator:
    if config.estimator.method == "window-ml":
        return WindowML(rig.model, settings)
    from agent.numerics.paper.seed_window import SeedSettings, SeedWindow

    sampled = discretise(rig.model.continuous(rig.model.nominal), settings.period_s, settings.hold)
    sigma = np.where(np.isfinite(settings.sigma), settings.sigma, 1.0)
    gain = settings.gains.start(sampled, Noise(sigma, np.zeros(rig.disturbance.shape[1]))).L
    passes = config.estimator.passes
    scale = np.where(np.isfinite(settings.scale), settings.scale, 1.0)
    seed = SeedSettings(settings.period_s, settings.plan, settings.hold, gain, passes, scale)
    return SeedWindow(rig.model, seed)
