"""The estimation methods by the names that configurations use."""

from dataclasses import replace
from functools import partial

import numpy as np

from agent.blocks.contained_estimator import ContainedEstimator
from agent.blocks.estimation import Estimation, Labels, Method
from agent.blocks.friction import signals
from agent.blocks.rig_model import RigModel, hop_plan, longer_windows, observer_gain, rig_model
from agent.blocks.statistical_rig import estimator_settings
from agent.config import RigConfig
from agent.errors import Fault, ModelError
from agent.numerics.estimator.schedule import Budget, budget_of
from agent.numerics.estimator.sliding import SlidingEstimator
from agent.numerics.model.statespace import discretise
from agent.numerics.window.filtering.hops import HopPlan
from agent.runtime.assembly.model_check import require_observable
from agent.types import FloatArray


def make_estimation(config: RigConfig, resolution: FloatArray) -> Estimation:
    """Build the estimation block of a rig; resolution (p,) is the wire's smallest step of each output, SI.

    Raises ModelError where a window has fewer readings than unknowns, or the channels cannot tell what is
    asked.
    """
    rig = rig_model(config)
    require_observable(config, rig)
    plan = hop_plan(config)
    _require_readings(config, rig, plan.window)
    longer = longer_windows(config, plan)
    physical = {"mass", "spring", "damper", "friction"}
    labels = Labels(
        rig=config.rig.name, method=config.estimator.method, parameters=tuple(p.name for p in rig.parameters),
        units=tuple(p.unit for p in rig.parameters), reference=np.array([p.nominal for p in rig.parameters]),
        baseline_id=None, window=plan.window, longest=max(plan.window, *longer, 0), hop=plan.hop,
        rate_hz=config.rig.sample_rate_hz, frictions=signals(config) - len(config.inputs),
        least=np.array([0.0 if p.kind in physical and p.nominal != 0 else -np.inf for p in rig.parameters]),
        enough=config.estimator.resolve * np.where(rig.limits > 0, rig.limits, np.inf),
    )  # fmt: skip
    make = partial(_estimator, config, rig, resolution)
    budget = budget_of(plan.window, 1 / config.rig.sample_rate_hz)
    estimator = ContainedEstimator(make, budget, plan, len(rig.parameters))
    return Estimation(estimator, labels)


def _require_readings(config: RigConfig, rig: RigModel, window: int) -> None:
    unknowns = len(rig.model.state_names) + len(rig.parameters)
    readings = window * len(config.outputs)
    if readings > unknowns:
        return
    shortest = (unknowns // max(len(config.outputs), 1) + 1) / config.rig.sample_rate_hz
    what = f"a window of {window} samples has {readings} readings for {unknowns} unknowns"
    raise ModelError([Fault("estimator.window_s", what, f"make it {shortest:g} s at the very least")])


def _estimator(config: RigConfig, rig: RigModel, resolution: FloatArray, budget: Budget) -> Method:
    if config.estimator.method == "window-ml":
        return SlidingEstimator(estimator_settings(config, resolution), budget)
    return _seed(config, rig, resolution)


def _seed(config: RigConfig, rig: RigModel, resolution: FloatArray) -> Method:
    """Return the paper's estimator, over one window or several."""
    from agent.numerics.paper.seed import Stopping
    from agent.numerics.paper.seed_window import SeedSettings, SeedWindow
    from agent.numerics.paper.seed_windows import SeedWindows

    period_s = 1.0 / config.rig.sample_rate_hz
    hold = config.estimator.hold
    sampled = discretise(rig.model.continuous(rig.model.nominal), period_s, hold)
    plan = hop_plan(config)
    gain = observer_gain(config, rig, sampled, resolution)
    enough = config.estimator.resolve * np.where(rig.limits > 0, rig.limits, np.inf)
    limited = np.where(rig.limits > 0, rig.limits, np.nan)
    scale = np.where(rig.model.nominal != 0, np.abs(rig.model.nominal), limited)
    stop = config.estimator.stop
    seed = SeedSettings(
        period_s, plan, hold, gain, config.estimator.passes, scale, enough,
        rank=config.estimator.rank, stopping=Stopping(stop.step, stop.cost, stop.iterations),
    )  # fmt: skip
    lengths = (plan.window, *longer_windows(config, plan))
    windows = [SeedWindow(rig.model, replace(seed, plan=HopPlan(length, plan.hop))) for length in lengths]
    return windows[0] if len(windows) == 1 else SeedWindows(windows)
