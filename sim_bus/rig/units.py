"""Channel units: how many SI units one of them is. Text that is no known unit is kept as it is (factor 1)."""

import math
from collections.abc import Mapping

_PREFIXES: Mapping[str, float] = {"k": 1e3, "d": 1e-1, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9, "": 1.0}
_LENGTHS: Mapping[str, float] = {f"{prefix}m": factor for prefix, factor in _PREFIXES.items()} | {
    "in": 0.0254,
    "inch": 0.0254,
    "mil": 0.0254e-3,
    "ft": 0.3048,
}
_FORCES: Mapping[str, float] = {
    "N": 1.0,
    "MN": 1e6,
    "kN": 1e3,
    "daN": 10.0,
    "mN": 1e-3,
    "uN": 1e-6,
    "kgf": 9.80665,
    "kp": 9.80665,
    "lbf": 0.45359237 * 9.80665,
    "kip": 453.59237 * 9.80665,
}
_REVOLUTION = 2.0 * math.pi  # fixed by definition, rad
_STANDARD_GRAVITY = {"g": 9.80665, "gn": 9.80665, "mg": 9.80665e-3}
SI_FACTORS: Mapping[str, Mapping[str, float]] = {
    "force": _FORCES,
    "displacement": _LENGTHS,
    "velocity": {f"{unit}/s": factor for unit, factor in _LENGTHS.items()} | {"km/h": 1.0 / 3.6},
    "acceleration": {
        f"{unit}{per}": factor for unit, factor in _LENGTHS.items() for per in ("/s2", "/s^2", "/s/s", " s-2")
    }
    | _STANDARD_GRAVITY,
    "voltage": {f"{prefix}V": factor for prefix, factor in _PREFIXES.items()},
    "current": {f"{prefix}A": factor for prefix, factor in _PREFIXES.items()},
    "power": {f"{prefix}W": factor for prefix, factor in _PREFIXES.items()},
    "torque": {f"{prefix}{unit}": factor for prefix, factor in _PREFIXES.items() for unit in ("N m", "Nm")},
    "speed": {
        "rpm": _REVOLUTION / 60.0,
        "1/min": _REVOLUTION / 60.0,
        "deg/s": _REVOLUTION / 360.0,
        "rev/s": _REVOLUTION,
    },
    "angle": {"mrad": 1e-3, "urad": 1e-6, "deg": _REVOLUTION / 360.0, "rev": _REVOLUTION},
    "flow": {"m3/h": 1.0 / 3600.0, "l/s": 1e-3, "l/min": 1e-3 / 60.0, "L/min": 1e-3 / 60.0, "ml/s": 1e-6},
    "pressure": {"kPa": 1e3, "hPa": 1e2, "MPa": 1e6, "mbar": 1e2, "bar": 1e5, "psi": 6894.757293168},
    "level": _LENGTHS,
}
_SPELLINGS = str.maketrans({"µ": "u", "μ": "u", "²": "2", "·": "*"})


def si_factor(quantity: str, unit: str) -> float:
    """Return the SI value of one `unit` of a quantity; 1.0 for text that is no unit of it."""
    return SI_FACTORS.get(quantity, {}).get(unit.strip().translate(_SPELLINGS), 1.0)
