"""What the sliding-window estimator is told."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.faults.masses import Masses
from agent.numerics.faults.mistakes import Mistakes
from agent.numerics.faults.suspects import Suspects
from agent.numerics.faults.verdict import Court
from agent.numerics.model.gains import Gains
from agent.numerics.model.statespace import Hold
from agent.numerics.window.hops import HopPlan

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class WindowSettings:
    """What `WindowML` is told.

    Attributes:
        period_s: sampling period, s.
        plan: window and hop, samples.
        hold: how the input runs between samples.
        gains: the observer's gains.
        sigma: (p,) standard deviation of each output's noise where known, NaN where it is to be learnt.
        floor: (p,) standard deviation that the wire's resolution alone causes.
        scale: (q,) size of each parameter, |nominal| or what stands for it; NaN where the data must say.
        lower: (q,) bounds from below.
        enough_sd: (q,) sd above which a window cannot judge a parameter ("unexcited").
        scale_column: (q,) the channel (outputs, then inputs) whose rms in the first window fitted is the size of a
            parameter without one (an offset); None where every parameter has a size.
        input_sd: (k,) noise of the first k inputs as far as it is known; None for none.
        suspects: what to look for where the model does not fit; None for nothing.
        court: tells a changed sensor from a changed structure; None believes in the structure.
        masses: those that the model takes as known, which may be wrong; None for nothing.
        mistakes: how channels may be wrong from the first sample; None to believe them.
        longer: further windows, samples, longer than the plan's by whole hops; each estimate is taken from the
            shortest that knows it to wanted_sd (q,).
        drift: samples of the window in which parameters that move may run straight lines; None where they may not.
        least_force: (d,) unknown force in each direction of the gains' that is there in any case, where the outputs'
            noise is stated; None for none.
    """

    period_s: float
    plan: HopPlan
    hold: Hold
    gains: Gains
    sigma: FloatArray
    floor: FloatArray
    scale: FloatArray
    lower: FloatArray
    enough_sd: FloatArray
    scale_column: IntArray | None = None
    longer: tuple[int, ...] = ()
    wanted_sd: FloatArray | None = None
    suspects: Suspects | None = None
    court: Court | None = None
    input_sd: FloatArray | None = None
    drift: int | None = None
    masses: Masses | None = None
    mistakes: Mistakes | None = None
    least_force: FloatArray | None = None

    @property
    def windows(self) -> int:
        """How many windows there are to be told apart; 0 where there is but one."""
        return 1 + len(self.longer) if self.longer else 0
