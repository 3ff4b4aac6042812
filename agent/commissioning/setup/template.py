"""A template of another domain, or a linear model, as the flags of `deltak init` state it."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any, Final

from agent.config.domains.kinds import DOMAINS
from agent.config.reading.units import examples
from agent.errors import Fault, UsageError

KINDS: Final = (*DOMAINS, "linear")
_ROW: Final = re.compile(r"([a-z]+):([^=,:]+)=(?:([^=,:]+),([^=,:]+):)?([^=,:]+)")
_SHAPES: Final = (
    "KEY=VALUE, KEY:NAME=VALUE or KEY:NAME=NODE,NODE:VALUE, such as --element R=4.8 --element tank:T1=0.05 "
    "--element restriction:r1=T1,ground:2e6, or TOML: --element 'stage={ R = 1.0, C = 1e-6 }'"
)
_TABLES: Final = ("sd_percent",)
_LISTS: Final = ("state", "parameter")


def kind_of(text: str | None) -> str | None:
    """Return the kind of model of --kind, None for masses, springs and dampers. Raises UsageError."""
    if text is None or text in KINDS:
        return text
    if text == "mass-spring-damper":
        return None
    raise UsageError.at("--kind", f'"{text}" is none', f"choose one of {', '.join(KINDS)}")


def model_of(kind: str, texts: Sequence[str]) -> dict[str, Any]:
    """Return a model's keys from the texts of --element; rows of one key make a list. Raises UsageError."""
    found: dict[str, Any] = {}
    for text in texts:
        key, value = _element(text)
        if _is_row(kind, key, value):
            found.setdefault(key, []).append(value)
        else:
            found[key] = value
    return found


def _element(text: str) -> tuple[str, Any]:
    row = _ROW.fullmatch(text.replace(" ", ""))
    try:
        if row is None:
            ((key, value),) = tomllib.loads(text).items()
            return key, value
        between = {} if row[3] is None else {"between": [row[3], row[4]]}
        return row[1], {"name": row[2], **between, "nominal": float(row[5])}
    except (tomllib.TOMLDecodeError, ValueError) as error:
        raise UsageError.at("--element", f'"{text}" is none', _SHAPES) from error


def _is_row(kind: str, key: str, value: object) -> bool:
    """Tell whether a value is one row of a list of tables."""
    return isinstance(value, Mapping) and (key in _LISTS if kind == "linear" else key not in _TABLES)


def keys_of_kind(kind: str) -> str:
    """Return the keys that a kind has of its own."""
    if kind == "linear":
        return "A, B, C, D, uncertain, state, parameter, time, rate_hz"
    return ", ".join(key for key in DOMAINS[kind].model_fields if key not in ("kind", *_TABLES))


def missing_of(kind: str, model: Mapping[str, Any], channels: Sequence[object]) -> list[Fault]:
    """Return a fault for the elements and for the channels where there are none."""
    found = []
    if not model:
        found.append(Fault("--element", "is missing", f"{_SHAPES}; keys are {keys_of_kind(kind)}"))
    if not channels:
        what = "input or output" if kind == "linear" else "a quantity of the plant"
        advice = f"one for each signal: NAME=QUANTITY[@PLACE][:UNIT[:FIELD]], QUANTITY {what}"
        found.append(Fault("--channel", "is missing", advice))
    return found


def signal_of(text: str) -> tuple[str, str, str, str, str]:
    """Read [NAME=]QUANTITY[@PLACE][:UNIT[:FIELD]]: name, quantity, place, unit, field. Raises UsageError."""
    match = re.fullmatch(r"(?:([^=@:]+)=)?([a-z]+)(?:@([^:@]+))?(?::([^:]*))?(?::(.+))?", text.strip())
    if match is None:
        advice = "[NAME=]QUANTITY[@PLACE][:UNIT[:FIELD]], such as --channel u=voltage:V"
        raise UsageError.at("--channel", f'"{text}" is none', advice)
    place = match[3] or ""
    name = match[1] or "_".join(part for part in (match[2], place.replace(".", "_")) if part)
    return name, match[2], place, match[4] or _unit(match[2]), match[5] or name


def _unit(quantity: str) -> str:
    """Return the unit that a quantity has where none is said."""
    known = {"input": "1", "output": "1", "temperature": "K"}
    return known.get(quantity) or examples(quantity).split(",")[0]  # type: ignore[arg-type]


def watched(kind: str, model: Mapping[str, Any]) -> str:
    """Return the name of a parameter to show an alarm of."""
    if kind == "linear":
        entries = [*model.get("uncertain", []), *(row["name"] for row in model.get("parameter", []))]
        return next((name for name in entries if len(name) > 1), "A[0,0]")
    try:
        rows = {key: tuple(value) if isinstance(value, list) else value for key, value in model.items()}
        parts = DOMAINS[kind].model_validate({"kind": kind, **rows}).parts
    except (ValueError, KeyError):
        return "R"
    return next((part.name for part in parts if part.kind == "element"), parts[0].name)
