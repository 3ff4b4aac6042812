"""Stages that know a rig's samples: quality, dry friction, estimation, channels, constants; remade together.

A failure in one of them costs what all of them know, and nothing that stands before or behind them.
"""

from collections import Counter
from dataclasses import dataclass

from agent.blocks.acquisition.interface import Through
from agent.blocks.channel_watch import ChannelWatch, Named
from agent.blocks.constants_watch import ConstantsWatch
from agent.blocks.estimation import Estimation
from agent.blocks.friction import DryFriction, dry_friction
from agent.blocks.quality import Quality, QualitySettings
from agent.blocks.rig_model import hop_plan, longest_bridge, rig_model, wire_of
from agent.config import RigConfig
from agent.runtime.assembly.methods import make_estimation
from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class Stages:
    """The stages between acquisition and alarms, new: they know of no sample."""

    quality: Quality
    friction: DryFriction
    estimation: Estimation
    channels: ChannelWatch
    constants: ConstantsWatch

    def through(self) -> Through:
        """Count the rows that acquisition handed on."""
        # inputs that only the motion gave away as spikes
        spikes = self.estimation.estimator.spikes
        rejected = self.quality.rejected + Counter({"spike": spikes})
        return Through(self.estimation.used - spikes, self.quality.waiting, rejected)


def make_stages(config: RigConfig, steps: FloatArray) -> Stages:
    """Build the stages of a rig; steps (c,) is the wire's smallest step of each channel, SI, inputs first.

    Raises ModelError.
    """
    rate_hz, rig = config.rig.sample_rate_hz, config.rig.name
    inputs = len(config.inputs)
    channels = [*config.inputs, *config.outputs]
    longest = longest_bridge(rig_model(config).model, rate_hz)
    window = hop_plan(config).window
    estimation = make_estimation(config, steps[inputs:])
    is_commanded = config.estimator.hold == "zero"
    settings = QualitySettings(
        channels=tuple(c.name for c in channels), inputs=inputs, step=steps, window=window, bridge=longest,
        quantities=tuple(c.quantity for c in channels), commanded=is_commanded, wire=wire_of(channels),
    )  # fmt: skip
    return Stages(
        quality=Quality(settings),
        friction=dry_friction(config, steps[inputs:]),
        estimation=estimation,
        channels=ChannelWatch(rig, tuple(Named.of(c) for c in (*config.outputs, *config.inputs))),
        constants=ConstantsWatch(
            rig, 1.0 / rate_hz, window, frozenset(c.name for c in config.outputs), is_commanded
        ),
    )
