"""From a configuration to the acquisition that its sources need."""

from collections.abc import Callable, Mapping
from functools import partial
from math import pi

import numpy as np

from agent.blocks.acquisition.alignment import Alignment
from agent.blocks.acquisition.interface import Acquisition, ChannelScale, SourcePlan
from agent.blocks.acquisition.single_source import SingleSource, source_plan
from agent.blocks.acquisition.skew_watch import SkewGroup, SkewWatch
from agent.blocks.acquisition.stream import AlignmentPlan, StreamPlan
from agent.blocks.friction import friction_inputs, signals
from agent.blocks.rig_model import hop_plan, known_noise, rig_model, scale_columns
from agent.blocks.tuning import LONGEST_STRETCH_S, MOST_STRETCH_SAMPLES, SHORTEST_STRETCH_S
from agent.config import LinearModel, RigConfig
from agent.config.model.tables import Channel
from agent.config.tables import Source
from agent.numerics.fitting.fit import FittedModel
from agent.numerics.fitting.skew import Group, SkewMeter
from agent.numerics.model.holds import straight
from agent.numerics.model.sensors import with_constant
from agent.numerics.model.statespace import modes
from agent.numerics.model.stick_slip import FrictionInputs
from agent.types import FloatArray

Maps = Mapping[str, Mapping[str, str]]


def make_acquisition(
    config: RigConfig, sources: Maps, resolution: FloatArray, *, keep_incomplete: bool = True
) -> Acquisition:
    """Return the acquisition of a rig.

    Args:
        config: the rig's configuration.
        sources: names of the sources that deliver, with their channel -> field maps.
        resolution: (p,) smallest step of each output's wire, SI.
        keep_incomplete: hand on rows that lack some reading.
    """
    channels = channels_of(config)
    names = [channel.name for channel in channels]
    scales = {c.name: ChannelScale(c.scale, c.offset, c.si_factor) for c in channels}
    plans = [source_plan(name, fields, names, scales) for name, fields in sources.items()]
    groups = skew_groups(config)
    late = configured_delays(config)
    if len(plans) == 1 and not groups and not late.any():
        rig = config.rig
        inputs = len(config.inputs)
        return SingleSource(plans[0], inputs, rig.clock, rig.sample_rate_hz, keep_incomplete=keep_incomplete)
    watch = _watch(config, groups, resolution) if groups else None
    remeasure = _remeasure(config, resolution) if len(plans) > 1 else None
    return Alignment(_plan(config, plans, late), watch, remeasure, keep_incomplete=keep_incomplete)


def _remeasure(config: RigConfig, resolution: FloatArray) -> Callable[[], SkewWatch] | None:
    """Return what watches all skews from anew; None where there is none to watch."""
    groups = _all_groups(config)
    return partial(_watch, config, groups, resolution) if groups else None


def channels_of(config: RigConfig) -> list[Channel]:
    """Return the channels in the order that the blocks know them by: inputs, then outputs."""
    return [*config.inputs, *config.outputs]


def reference_source(config: RigConfig) -> Source | None:
    """Return the source whose samples make rows: the first input's, else the first; None without sources."""
    first = config.inputs[0].name if config.inputs else ""
    return next((s for s in config.source if first in s.map), config.source[0] if config.source else None)


def configured_delays(config: RigConfig) -> FloatArray:
    """Return how late each channel is read (c,), s: its own delay, plus its source's skew where given."""
    given = {name: s.skew_s for s in config.source for name in s.map if isinstance(s.skew_s, float)}
    return np.array([channel.delay_s + given.get(channel.name, 0.0) for channel in channels_of(config)])


def skew_groups(config: RigConfig) -> tuple[SkewGroup, ...]:
    """Return the sources whose skew is to be measured, with their channels."""
    wanted = {source.name for source in config.source if source.skew_s == "auto"}
    return tuple(group for group in _all_groups(config) if group.source in wanted)


def _all_groups(config: RigConfig) -> tuple[SkewGroup, ...]:
    if isinstance(config.model, LinearModel) and config.model.time == "discrete":
        return ()  # nothing is said of what lies between samples
    reference = reference_source(config)
    names = [channel.name for channel in channels_of(config)]
    others = [source for source in config.source if source is not reference]
    return tuple(SkewGroup(s.name, tuple(names.index(name) for name in s.map)) for s in others)


def _plan(config: RigConfig, plans: list[SourcePlan], late: FloatArray) -> AlignmentPlan:
    known = {source.name: source for source in config.source}
    rate = config.rig.sample_rate_hz
    streams = []
    for plan in plans:
        source = known.get(plan.name)
        own_rate = source.rate_hz if source is not None else None
        own_clock = source is not None and (source.own_clock or own_rate is not None)
        streams.append(StreamPlan(plan, own_rate or rate, own_clock))
    reference = next((i for i, plan in enumerate(plans) if 0 in plan.columns), 0)
    first = min(plans[reference].columns)
    return AlignmentPlan(
        tuple(streams), reference, len(late), len(config.inputs), config.rig.clock, rate,
        delay_s=late - late[first], late_s=float(late[first]),
    )  # fmt: skip


def _watch(config: RigConfig, groups: tuple[SkewGroup, ...], resolution: FloatArray) -> SkewWatch:
    meter = skew_meter(config, groups, resolution)
    reference = reference_source(config)
    return SkewWatch(
        meter, groups, "" if reference is None else reference.name, len(channels_of(config)),
        len(config.inputs),
        *stretch_samples(config), config.rig.sample_rate_hz, complete_inputs(config, resolution),
    )  # fmt: skip


def complete_inputs(
    config: RigConfig, resolution: FloatArray
) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Return what makes all model inputs of outputs and measured inputs: signs of dry friction, the 1."""
    model = rig_model(config).model
    return _Complete(friction_inputs(config, resolution), model.continuous(model.nominal).m)


class _Complete:
    """What `complete_inputs` returns; a class, since a pipeline is kept with its states."""

    def __init__(self, friction: FrictionInputs | None, columns: int) -> None:
        self._friction, self._columns = friction, columns

    def __call__(self, y: FloatArray, u: FloatArray) -> FloatArray:
        if self._friction is not None:
            self._friction.start_segment()
            u = self._friction.beside(y, u)
        return with_constant(u, self._columns)


def skew_meter(config: RigConfig, groups: tuple[SkewGroup, ...], resolution: FloatArray) -> SkewMeter:
    """Return what measures the skews of channel groups; resolution (p,) is that of the outputs' wires, SI."""
    inputs = len(config.inputs)
    rig = rig_model(config)
    physical = np.array([p.kind in ("mass", "spring", "damper", "friction") for p in rig.parameters])
    lower = np.where(physical & (rig.model.nominal != 0), 0.0, -np.inf)
    late = tuple(
        Group(
            tuple(c for c in group.channels if c < inputs),
            tuple(c - inputs for c in group.channels if c >= inputs),
        )
        for group in groups
    )
    return SkewMeter(fitted_model(config, resolution, lower), late, signals(config))


def fitted_model(config: RigConfig, resolution: FloatArray, lower: FloatArray) -> FittedModel:
    """Return the model that readings are fitted with, its parameters bounded by lower (q,).

    resolution: (p,) smallest step of each output's wire, SI.
    """
    rig = rig_model(config)
    nominal = rig.model.nominal
    limited = np.where(rig.limits > 0, rig.limits, np.nan)
    scale = np.where(nominal != 0, np.abs(nominal), limited)
    return FittedModel(
        rig.model, 1.0 / config.rig.sample_rate_hz, straight(config.estimator.hold),
        rig.disturbance, known_noise(config, resolution), scale, lower, scale_columns(config, rig),
    )  # fmt: skip


def stretch_samples(config: RigConfig) -> tuple[int, int]:
    """Return how long a stretch that tells a skew is: first the shortest window, at most half a period."""
    model, rate = rig_model(config).model, config.rig.sample_rate_hz
    speeds = np.abs(modes(model.continuous(model.nominal), 1.0 / rate))
    slowest = float(np.min(speeds[speeds > 1e-9 * speeds.max()], initial=speeds.max()))
    unknowns = len(model.state_names) + len(model.parameters) + 1
    least = max(hop_plan(config).window, 20 * unknowns // max(len(config.outputs), 1))
    longest = round(float(np.clip(pi / max(slowest, 1e-9), SHORTEST_STRETCH_S, LONGEST_STRETCH_S)) * rate)
    return min(least, MOST_STRETCH_SAMPLES), max(
        min(longest, MOST_STRETCH_SAMPLES), min(least, MOST_STRETCH_SAMPLES)
    )
