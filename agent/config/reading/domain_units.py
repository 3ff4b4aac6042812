"""Units of other domains than mechanics; temperatures keep degC or K, since only differences matter."""

from collections.abc import Mapping
from typing import Final

QUANTITIES: Final = (
    "voltage", "current", "torque", "speed", "angle", "power", "temperature", "flow", "pressure", "level",
)  # fmt: skip
TURN: Final = 6.283185307179586  # fixed by definition, rad

KNOWN: Final[Mapping[str, Mapping[str, float]]] = {
    "voltage": {"V": 1.0, "mV": 1e-3, "uV": 1e-6, "kV": 1e3},
    "current": {"A": 1.0, "mA": 1e-3, "uA": 1e-6, "kA": 1e3},
    "torque": {"N m": 1.0, "Nm": 1.0, "mN m": 1e-3, "mNm": 1e-3, "kN m": 1e3, "kNm": 1e3},
    "speed": {"rad/s": 1.0, "rpm": TURN / 60, "1/min": TURN / 60, "deg/s": TURN / 360, "rev/s": TURN},
    "angle": {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": TURN / 360, "rev": TURN},
    "power": {"W": 1.0, "mW": 1e-3, "kW": 1e3},
    "flow": {
        "m3/s": 1.0,
        "m3/h": 1 / 3600,
        "l/s": 1e-3,
        "l/min": 1e-3 / 60,
        "L/min": 1e-3 / 60,
        "ml/s": 1e-6,
    },
    "pressure": {
        "Pa": 1.0,
        "kPa": 1e3,
        "hPa": 1e2,
        "MPa": 1e6,
        "mbar": 1e2,
        "bar": 1e5,
        "psi": 6894.757293168,
    },
}
SI: Final[Mapping[str, str]] = {
    "voltage": "V", "current": "A", "torque": "N m", "speed": "rad/s", "angle": "rad", "power": "W",
    "flow": "m3/s", "pressure": "Pa", "level": "m",
}  # fmt: skip
TEMPERATURES: Final = ("degC", "K")
