"""Units of channels: what is known becomes SI, any other text is kept and carried along."""

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Final, Literal

from agent.config.reading import domain_units
from agent.config.tuning import UNIT_LETTERS

Quantity = Literal[
    "force", "displacement", "velocity", "acceleration", "input", "output",
    "voltage", "current", "torque", "speed", "angle", "power", "temperature", "flow", "pressure", "level",
]  # fmt: skip

_LENGTH: Final[Mapping[str, float]] = {
    "m": 1.0, "km": 1e3, "dm": 1e-1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9,
    "in": 0.0254, "inch": 0.0254, "mil": 2.54e-5, "ft": 0.3048,
}  # fmt: skip
_FORCE: Final[Mapping[str, float]] = {
    "N": 1.0, "MN": 1e6, "kN": 1e3, "daN": 10.0, "mN": 1e-3, "uN": 1e-6,
    "kgf": 9.80665, "kp": 9.80665, "lbf": 4.4482216152605, "kip": 4448.2216152605,
}  # fmt: skip
_VELOCITY: Final[Mapping[str, float]] = {f"{unit}/s": factor for unit, factor in _LENGTH.items()} | {
    "km/h": 1 / 3.6
}
_ACCELERATION: Final[Mapping[str, float]] = {
    spelling.format(unit): factor
    for unit, factor in _LENGTH.items()
    for spelling in ("{}/s2", "{}/s^2", "{}/s/s", "{} s-2")
} | {"g": 9.80665, "gn": 9.80665, "mg": 9.80665e-3}

_PREFIXES: Final[Mapping[str, str]] = {
    "": "", "nano": "n", "micro": "u", "milli": "m", "centi": "c", "deci": "d", "deca": "da", "kilo": "k",
    "mega": "M",
}  # fmt: skip


def _spelt(words: tuple[str, ...], unit: str, known: Mapping[str, float]) -> dict[str, str]:
    """Return words with their prefixes, singular and plural -> units, of those that are known."""
    every = {f"{long}{word}": f"{short}{unit}" for word in words for long, short in _PREFIXES.items()}
    every |= {f"{word}s": symbol for word, symbol in every.items()}
    return {word: symbol for word, symbol in every.items() if symbol in known}


_LENGTH_WORDS: Final = _spelt(("meter", "metre"), "m", _LENGTH) | {
    "micron": "um",
    "inches": "in",
    "feet": "ft",
}
_WORDS: Final[Mapping[str, Mapping[str, str]]] = {
    "force": _spelt(("newton",), "N", _FORCE) | {"pounds": "lbf", "kilopond": "kp"},
    "displacement": _LENGTH_WORDS,
    "velocity": {f"{word}/s": f"{unit}/s" for word, unit in _LENGTH_WORDS.items()},
    "acceleration": {f"{word}/s2": f"{unit}/s2" for word, unit in _LENGTH_WORDS.items()},
}

_SI: Final[Mapping[str, str]] = {
    "force": "N", "displacement": "m", "velocity": "m/s", "acceleration": "m/s2", **domain_units.SI,
}  # fmt: skip
_MECHANICAL: Final[Mapping[str, Mapping[str, float]]] = {
    "force": _FORCE,
    "displacement": _LENGTH,
    "velocity": _VELOCITY,
    "acceleration": _ACCELERATION,
}
_KNOWN: Final[Mapping[str, Mapping[str, float]]] = {**_MECHANICAL, **domain_units.KNOWN, "level": _LENGTH}
_OTHER_KINDS: Final[Mapping[str, tuple[str, ...]]] = {
    "mass": ("kg", "g", "mg", "t", "lb"),
    "time": ("s", "ms", "us", "min", "h"),
    "frequency": ("Hz", "kHz", "MHz"),
    "stiffness": ("N/m", "kN/m", "N/mm", "N/um"),
    "damping": ("N s/m", "Ns/m", "N*s/m", "kN s/m", "kNs/m", "N s/mm", "Ns/mm"),
}


def normal(unit: str) -> str:
    """Return one spelling of a unit: both micro signs become u, superscript two 2, no outer blanks."""
    return unit.strip().translate({0xB5: "u", 0x3BC: "u", 0xB2: "2", 0xB7: "*"})


def conversion(quantity: Quantity, unit: str) -> tuple[float, str]:
    """Return (factor, SI unit) of a channel; factor 1.0 and the text itself where the unit is unknown."""
    factor = _KNOWN.get(quantity, {}).get(normal(unit))
    return (1.0, unit.strip()) if factor is None else (factor, _SI[quantity])


def wrong_kind(quantity: Quantity, unit: str) -> str | None:
    """Return what a known unit measures where that is not the quantity; None where nothing is wrong.

    Inputs and outputs of linear models take any unit; so do forces and motions, whose sensors may count in
    volts.
    """
    text = normal(unit)
    if quantity not in _KNOWN or text in _KNOWN[quantity]:
        return None
    others = {} if quantity in _MECHANICAL else domain_units.KNOWN
    kinds = {**_MECHANICAL, **others, **_OTHER_KINDS}
    return next((kind for kind, units in kinds.items() if text in units), None)


def near_miss(quantity: Quantity, unit: str) -> str:
    """Return the unit that unknown text of a channel looks like: another case, or misspelt; empty if none.

    Such text is kept as a unit of its own, so that every parameter comes out in it.
    """
    known = _KNOWN.get(quantity, {})
    text = normal(unit)
    if not known or text in known:
        return ""
    alike = [name for name in known if name.casefold() == text.casefold()]
    spelt = _WORDS.get(quantity, {})
    words = get_close_matches(text.casefold(), spelt, n=1, cutoff=0.8) if len(text) > UNIT_LETTERS else []
    return " or ".join(alike) or (spelt[words[0]] if words else "")


def is_known(quantity: Quantity, unit: str) -> bool:
    """Tell whether a unit is one of those of a quantity; a temperature's are degC and K."""
    return normal(unit) in _KNOWN.get(quantity, domain_units.TEMPERATURES)


def examples(quantity: Quantity) -> str:
    """Return some units of a quantity, for advice."""
    return ", ".join(list(_KNOWN.get(quantity, domain_units.TEMPERATURES))[:6])


def base_length(displacement: str | None, velocity: str | None, acceleration: str | None) -> str:
    """Return the length unit of parameters, from the SI units of what is measured; metres if nothing is."""
    if displacement:
        return displacement
    for unit, ending, power in ((velocity, "/s", "s"), (acceleration, "/s2", "s2")):
        if unit:
            return unit.removesuffix(ending) if unit.endswith(ending) else f"({unit} {power})"
    return "m"


def element_units(force: str, length: str) -> dict[str, str]:
    """Return the units of mass, spring, damper and dry friction for given units of force and length."""
    mass = "kg" if (force, length) == ("N", "m") else f"{force} s2/{length}"
    return {"mass": mass, "spring": f"{force}/{length}", "damper": f"{force} s/{length}", "friction": force}
