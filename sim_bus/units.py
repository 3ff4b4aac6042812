"""Units of channels: how many SI units one of them is. Units that are not listed are kept as they are (factor 1)."""

from collections.abc import Mapping

SI_FACTORS: Mapping[str, float] = {
    "N": 1.0,
    "mN": 1e-3,
    "kN": 1e3,
    "MN": 1e6,
    "m": 1.0,
    "cm": 1e-2,
    "mm": 1e-3,
    "um": 1e-6,
    "µm": 1e-6,
    "μm": 1e-6,
    "nm": 1e-9,
    "m/s": 1.0,
    "mm/s": 1e-3,
    "um/s": 1e-6,
    "µm/s": 1e-6,
    "μm/s": 1e-6,
    "m/s2": 1.0,
    "m/s^2": 1.0,
    "m/s²": 1.0,
    "mm/s2": 1e-3,
    "mm/s^2": 1e-3,
    "mm/s²": 1e-3,
    "g": 9.80665,
}


def si_factor(unit: str) -> float:
    """Return the SI value of one `unit`; 1.0 for text that is no known unit."""
    return SI_FACTORS.get(unit, 1.0)
