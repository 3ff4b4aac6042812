"""What a new configuration is made of, as flags or answers state it, and what is still missing."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from agent.commissioning.setup.template import keys_of_kind, kind_of, missing_of, model_of, signal_of
from agent.config.model.tables import GROUND
from agent.errors import Fault, UsageError

ELEMENTS = {"spring": "k", "damper": "B", "friction": "F"}
"""Kinds of elements, and the letter that a chain's are called by."""
CHAINED = ("spring", "damper")
BUSES = ("can", "serial", "modbus")
UNITS = {"force": "N", "displacement": "m", "velocity": "m/s", "acceleration": "m/s2"}
NONE = "none"
_LETTERS = {"force": "f", "displacement": "x", "velocity": "v", "acceleration": "a"}
_CHANNEL = re.compile(r"(?:([^=@:]+)=)?([a-z]+)@([^:@]+)(?::([^:]*))?(?::(.+))?")
_ELEMENT = re.compile(r"([^=]+)=([^,:]+),([^,:]+)(?::(.+))?")


@dataclass(frozen=True)
class Link:
    """A spring, damper or dry friction between two nodes; nominal None where nobody knows it."""

    name: str
    between: tuple[str, str]
    nominal: float | None = None


@dataclass(frozen=True)
class Signal:
    """A channel: what is measured where, in which unit, and the bus's field that carries it."""

    name: str
    quantity: str
    at: str
    unit: str
    field: str


@dataclass
class Plan:
    """A configuration to be written.

    Attributes:
        kind: of a template or "linear"; None for masses, springs and dampers;  model: its own keys.
        masses: values in kg by name.
        elements: by kind; a kind that nobody spoke of becomes a chain.
        keys: the driver's own keys, as flags give them; None where a flag was not given.
    """

    name: str | None = None
    bus: str | None = None
    rate_hz: float | None = None
    kind: str | None = None
    model: dict[str, Any] = field(default_factory=dict)
    masses: dict[str, float] = field(default_factory=dict)
    elements: dict[str, list[Link] | None] = field(default_factory=dict)
    channels: list[Signal] = field(default_factory=list)
    counter: str | None = None
    keys: dict[str, Any] = field(default_factory=dict)

    def links(self, kind: str) -> list[Link]:
        """Return the elements of a kind; springs and dampers not named join ground and masses in order."""
        stated = self.elements.get(kind)
        if stated is not None or kind not in CHAINED:
            return stated or []
        ends = [GROUND, *self.masses]
        return [Link(f"{ELEMENTS[kind]}{i}", pair) for i, pair in enumerate(pairwise(ends), 1)]

    def missing(self) -> list[Fault]:
        """Return a fault for each thing that has no default, naming its flag."""
        found = []
        if self.rate_hz is None:
            found.append(Fault("--rate", "is missing", "samples a second, such as --rate 1000"))
        if self.kind is not None:
            found += missing_of(self.kind, self.model, self.channels)
        else:
            found += self._missing_of_graph()
        return found + [Fault(flag, "is missing", advice) for flag, advice in self._missing_keys()]

    def _missing_of_graph(self) -> Iterator[Fault]:
        if not self.masses:
            yield Fault("--mass", "is missing", "one for each mass in kg, such as --mass m1=5 --mass m2=3")
        if not any(channel.quantity != "force" for channel in self.channels):
            advice = (
                "one for each signal: [NAME=]QUANTITY@MASS[:UNIT[:FIELD]], "
                "such as --channel x1=displacement@m1:mm"
            )
            yield Fault("--channel", "nothing that is measured of the motion is named", advice)

    def _missing_keys(self) -> Iterator[tuple[str, str]]:
        has = {key for key, value in self.keys.items() if value}
        if self.bus == "can" and "dbc" not in has:
            yield "--dbc", "the file that describes the frames, such as --dbc rig.dbc"
        if self.bus == "serial":
            yield from self._missing_of_line(has)
        if self.bus == "modbus":
            yield from self._missing_registers(has)

    def _missing_of_line(self, has: set[str]) -> Iterator[tuple[str, str]]:
        if "port" not in has:
            yield "--port", "the line's device, such as --port /dev/serial/by-id/..."
        if not has & {"columns", "fields"}:
            advice = (
                "lines of text: --columns n,force,x1; "
                "binary frames: --sync AA55 --fields force:int16:1e-3,..."
            )
            yield "--columns or --fields", advice
        if "fields" in has and "sync" not in has:
            yield "--sync", "the bytes that every binary frame begins with, such as --sync AA55"

    def _missing_registers(self, has: set[str]) -> Iterator[tuple[str, str]]:
        if "fields" not in has:
            yield (
                "--fields",
                "NAME[@ADDRESS]:TYPE[:SCALE], such as --fields force@100:int16:1e-3,x1@101:int16",
            )
        if len(has & {"ring", "index"}) == 1:
            other = "--index" if "ring" in has else "--ring"
            yield other, "a ring has both: --index ADDRESS[:TYPE] and --ring ADDRESS:SLOTS"


def stated(
    bus: str | None, name: str | None, rate_hz: float | None, listed: tuple[Sequence[str], Sequence[str]],
    elements: Mapping[str, Sequence[str] | None], counter: str | None, keys: Mapping[str, Any],
    template: tuple[str | None, Sequence[str]] = (None, ()),
) -> Plan:  # fmt: skip
    """Return what flags state; listed: texts of masses and of channels; template: a kind and its elements.

    Raises UsageError.
    """
    links = {kind: links_of(texts or [], f"--{kind}") for kind, texts in elements.items()}
    masses, channels = listed
    kind = kind_of(template[0])
    _of_one_kind(kind, [*(f"--{key}" for key, found in links.items() if found), *(["--mass"] * bool(masses))])
    if template[1] and kind is None:
        advice = "give --kind too, such as --kind dc-motor; graphs have --mass, --spring and --damper"
        raise UsageError.at("--element", "goes with the kind of a model", advice)
    return Plan(
        name, bus, rate_hz, kind, model_of(kind or "", template[1]), dict(map(mass_of, masses)), links,
        [channel_of(text, kind) for text in channels], counter, dict(keys),
    )  # fmt: skip


def _of_one_kind(kind: str | None, graph: Sequence[str]) -> None:
    """Refuse elements of a graph beside a template."""
    if kind is not None and graph:
        what = f"does not go with --kind {kind}, which has no such elements"
        raise UsageError.at(graph[0], what, f"write them as --element; keys are {keys_of_kind(kind)}")


def mass_of(text: str) -> tuple[str, float]:
    """Read NAME=KG."""
    name, _, value = text.partition("=")
    return name.strip(), number_of(value, "--mass", text)


def link_of(text: str, flag: str) -> Link:
    """Read NAME=NODE,NODE[:NOMINAL]."""
    match = _ELEMENT.fullmatch(text.replace(" ", ""))
    if match is None:
        raise UsageError.at(
            flag, f'"{text}" is none', f"NAME=NODE,NODE[:NOMINAL], such as {flag} c1=ground,m1"
        )
    nominal = None if match[4] is None else number_of(match[4], flag, text)
    return Link(match[1], (match[2], match[3]), nominal)


def links_of(texts: Sequence[str], flag: str) -> list[Link] | None:
    """Read all elements of a kind: None where nothing was said, none where "none" was."""
    if not texts:
        return None
    return [] if list(texts) == [NONE] else [link_of(text, flag) for text in texts]


def channel_of(text: str, kind: str | None = None) -> Signal:
    """Read [NAME=]QUANTITY@MASS[:UNIT[:FIELD]]; of a kind that is no graph @PLACE may be left out."""
    if kind is not None:
        return Signal(*signal_of(text))
    match = _CHANNEL.fullmatch(text.strip())
    if match is None:
        raise _no_channel(text)
    known = {q: u for q, u in UNITS.items() if q.startswith(match[2])}
    if len(known) != 1:
        raise _no_channel(text)
    ((quantity, unit),) = known.items()
    name = match[1] or _LETTERS[quantity] + (re.sub(r"\D", "", match[3]) or f"_{match[3]}")
    return Signal(name, quantity, match[3], match[4] or unit, match[5] or name)


def _no_channel(text: str) -> UsageError:
    advice = "[NAME=]QUANTITY@MASS[:UNIT[:FIELD]], such as --channel x1=displacement@m1:mm; quantities are "
    return UsageError.at("--channel", f'"{text}" is none', advice + ", ".join(UNITS))


def number_of(text: str, flag: str, whole: str = "") -> float:
    """Read a number of a flag. Raises UsageError."""
    try:
        return float(text)
    except ValueError:
        shown = f'"{whole or text}"'
        raise UsageError.at(flag, f"{shown} holds no number", "write one such as 5.0") from None


def fields_of(text: str) -> list[dict[str, Any]]:
    """Read NAME[@ADDRESS]:TYPE[:SCALE],... Raises UsageError."""
    return [_field(part.strip()) for part in text.split(",") if part.strip()]


def _field(text: str) -> dict[str, Any]:
    head, _, rest = text.partition(":")
    name, _, address = head.partition("@")
    kind, _, scale = rest.partition(":")
    if not name or not kind:
        advice = "NAME[@ADDRESS]:TYPE[:SCALE], such as force:int16:1e-3"
        raise UsageError.at("--fields", f'"{text}" is none', advice)
    found: dict[str, Any] = {"name": name}
    if address:
        found["address"] = int(number_of(address, "--fields", text))
    found["type"] = kind
    return found | ({"scale": number_of(scale, "--fields", text)} if scale else {})


def place_of(text: str, flag: str, second: str, default: str = "") -> Mapping[str, Any]:
    """Read ADDRESS:WHAT as a table { address, second }. Raises UsageError."""
    address, _, rest = text.partition(":")
    value: Any = rest or default
    if second == "slots":
        value = int(number_of(rest, flag, text))
    return {"address": int(number_of(address, flag, text)), second: value}
