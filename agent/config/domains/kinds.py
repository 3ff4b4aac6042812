"""The templates by their kind, and the numbers that the estimator needs of one."""

from collections.abc import Mapping
from typing import Final

from agent.config.domains.electrical import RlcLadder
from agent.config.domains.electromechanical import DcMotor, VoiceCoil
from agent.config.domains.frames import Frame
from agent.config.domains.hydraulic import Hydraulic
from agent.config.domains.plant import Domain
from agent.config.domains.rotating import Torsional
from agent.config.domains.thermal import Thermal

DomainModel = RlcLadder | DcMotor | VoiceCoil | Thermal | Hydraulic | Torsional | Frame
DOMAINS: Final[Mapping[str, type[Domain]]] = {
    "rlc-ladder": RlcLadder,
    "dc-motor": DcMotor,
    "voice-coil": VoiceCoil,
    "thermal": Thermal,
    "hydraulic": Hydraulic,
    "torsional": Torsional,
    "frame": Frame,
}
