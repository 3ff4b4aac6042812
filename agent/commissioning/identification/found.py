"""An identified rig: the configuration with what was found, and what that explains."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from agent.blocks.rig_model import RigModel
from agent.commissioning.explained import Explained
from agent.commissioning.numerics.motion.pooled import Pooled
from agent.config import RigConfig
from agent.numerics.model.uncertain import Constant
from agent.types import BoolArray, FloatArray


@dataclass(frozen=True)
class Rival:
    """Another solution that explains the recordings as well: values and sds (q,), which of them differ (q,).

    place: the displacement that would tell the two apart; empty where none would.
    """

    theta: FloatArray
    sd: FloatArray
    differs: BoolArray
    place: str


@dataclass(frozen=True)
class Found:
    """Everything found: the configuration with it, the rig's parameters, windows, and what they explain."""

    config: RigConfig
    rig: RigModel
    pooled: Pooled
    window: int
    windows: int
    seen: Explained
    constants: tuple[Constant, ...]
    helpful: Mapping[int, str] = field(default_factory=dict)
    """Displacements that would show parameters that are not known, by the parameters' numbers."""
    rival: Rival | None = None
    units: str = ""
    """Of a graph that is refused: in which units of the channels it would fit, in words."""

    def rival_in(self, i: int) -> Rival | None:
        """Return the other solution that differs in a parameter, by its number; None without one."""
        return self.rival if self.rival is not None and self.rival.differs[i] else None
