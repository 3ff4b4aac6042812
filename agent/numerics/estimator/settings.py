"""What the sliding-window estimator is configured with."""

from dataclasses import dataclass

from agent.numerics.model.uncertain import Rig
from agent.numerics.preprocessing.wire import Wire
from agent.numerics.window.filtering.hops import HopPlan
from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class EstimatorSettings:
    """Settings of `SlidingEstimator`.

    Attributes:
        rig: what is modelled.
        plan: window and hop, samples.
        longer: further windows, samples, longer by whole hops.
        sigma: (p,) sensor sd where known, NaN where it is to be learnt, SI.
        sigma_spread: (p,) sd of its logarithm.
        floor: (p,) sensor sd that the wire's resolution alone causes, SI.
        enough_sd: (q,) sd above which a window cannot judge a parameter ("unexcited").
        wanted_sd: (q,) sd that needs no longer window.
        wire: what outputs come in.
    """

    rig: Rig
    plan: HopPlan
    longer: tuple[int, ...]
    sigma: FloatArray
    sigma_spread: FloatArray
    floor: FloatArray
    enough_sd: FloatArray
    wanted_sd: FloatArray
    wire: Wire

    @property
    def outputs(self) -> int:
        """P."""
        return len(self.sigma)

    @property
    def windows(self) -> tuple[int, ...]:
        """All window lengths, samples, shortest first."""
        return (self.plan.window, *self.longer)
