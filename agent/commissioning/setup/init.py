"""`deltak init`: a first configuration file, from flags and, on a terminal, from answers."""

import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from agent.commissioning.setup.plan import (
    BUSES,
    ELEMENTS,
    NONE,
    Plan,
    Signal,
    channel_of,
    links_of,
    mass_of,
    number_of,
)
from agent.commissioning.setup.template import keys_of_kind, model_of
from agent.commissioning.setup.text import text_of
from agent.config.load import parse
from agent.errors import ConfigError, Fault, UsageError


def dbc_signals(file: Path) -> list[str]:
    """Return every signal of a DBC file as "message.signal". Raises UsageError."""
    import cantools

    try:
        database = cantools.database.load_file(file)
    except (OSError, ValueError, cantools.Error) as error:
        words = " ".join(str(error).split())
        advice = "name a DBC file; it may lie beside FILE"
        raise UsageError.at("--dbc", f"{file} cannot be read: {words}", advice) from error
    messages = getattr(database, "messages", [])
    return [f"{message.name}.{signal.name}" for message in messages for signal in message.signals]


def placed(wanted: str, signals: list[str], what: str) -> str:
    """Return the signal called so, its message left out or not, whatever the case. Raises UsageError."""
    same = [
        signal
        for signal in signals
        if wanted.casefold() in (signal.casefold(), signal.split(".")[1].casefold())
    ]
    if len(same) == 1:
        return same[0]
    number = "several signals are" if same else "no signal is"
    place = f"{what} " if what.startswith("--") else "--channel ...:UNIT:"
    advice = f"name one of {', '.join(same or signals[:20])}, as {place}MESSAGE.SIGNAL"
    raise UsageError.at("--dbc", f'{what}: {number} called "{wanted}"', advice)


QUESTIONS = {
    "can": (("channel", "CAN interface", "can0"),),
    "serial": (
        ("baudrate", "baud", "115200"),
        ("columns", "cells of a line of text, such as n,force,x1; empty for binary frames", ""),
    ),
    "modbus": (
        ("host", "address of the device (TCP)", "127.0.0.1"),
        ("port", "TCP port, or the path of a serial line", "502"),
        (
            "index",
            "register that counts the samples of a ring, ADDRESS[:TYPE]; empty where registers are polled",
            "",
        ),
    ),
}
"""What is asked of a bus beside what has no default: key, question, default."""
Ask = Callable[[str, str], str]
"""Asks a question with what an empty answer means, and returns the answer."""


def init(file: Path, plan: Plan, ask: Ask | None) -> dict[str, Any]:
    """Write a configuration; return its path, rig, channels and what is yet to be identified.

    Args:
        file: where to; must not exist.
        plan: what flags say.
        ask: asks on a terminal for what they do not; None where nobody can answer.

    Raises UsageError for what is missing or cannot be read, ConfigError for what does not fit together.
    """
    if file.exists():
        raise UsageError.at("FILE", f"{file} is there already", "name another file; nothing was changed")
    if plan.name is None:
        plan.name = _default_name(file)
    if ask is not None:
        _ask_all(plan, ask)
    if missing := plan.missing():
        raise UsageError(
            [*missing, *([] if ask else [Fault("", "no terminal to ask on: state these as flags")])]
        )
    if plan.bus == "can":
        _place_signals(plan, file.parent)
    text = text_of(plan)
    _checked(text, file)
    _write(file, text)
    links = [] if plan.kind else [link for kind in ELEMENTS for link in plan.links(kind)]
    unknown = [link.name for link in links if link.nominal is None]
    return {
        "file": str(file), "rig": plan.name, "bus": plan.bus, "channels": [c.name for c in plan.channels],
        "to_identify": unknown,
    }  # fmt: skip


def _checked(text: str, file: Path) -> None:
    """Refuse a plan whose parts do not fit together, in the words of `check`, before anything is written."""
    try:
        parse(text.encode("utf-8"), Path(os.path.abspath(file)), identified=True)  # noqa: PTH100 - as load does
    except ConfigError as error:
        raise ConfigError(
            [*error.faults, Fault(str(file), "was not written", "change the flags or answers that say so")]
        ) from error


def _write(file: Path, text: str) -> None:
    try:
        with file.open("x", encoding="utf-8") as stream:
            stream.write(text)
    except OSError as error:
        advice = "name a file in a folder that can be written"
        raise UsageError.at("FILE", f"{file} cannot be written: {error.strerror or error}", advice) from error


def _default_name(file: Path) -> str:
    name = re.sub(r"[^A-Za-z0-9_.-]", "-", file.stem)
    return name if re.match(r"[A-Za-z]", name) else f"rig-{name}"


def _place_signals(plan: Plan, folder: Path) -> None:
    """Give channels of a CAN bus the signals of the DBC file that are called like them."""
    signals = dbc_signals(folder / str(plan.keys["dbc"]))
    plan.channels = [
        replace(channel, field=placed(channel.field, signals, channel.name)) for channel in plan.channels
    ]
    if plan.counter is not None:
        plan.counter = placed(plan.counter, signals, "--counter")


def _ask_all(plan: Plan, ask: Ask) -> None:
    """Ask for what flags left open."""
    if plan.bus is None:
        plan.bus = _one_of(ask, "bus (can, serial, modbus, or none for recordings)", (*BUSES, NONE))
    plan.bus = None if plan.bus == NONE else plan.bus
    plan.name = ask("name of the rig", plan.name or "rig")
    if plan.rate_hz is None:
        plan.rate_hz = number_of(ask("samples a second", "1000"), "samples a second")
    if plan.kind is None:
        _ask_graph(plan, ask)
    elif not plan.model:
        answers = iter(
            lambda: ask(f"element of {plan.kind}: {keys_of_kind(str(plan.kind))}; empty ends", ""), ""
        )
        plan.model = model_of(plan.kind, list(answers))
    if not plan.channels:
        plan.channels = _channels(ask, plan.kind)
    _ask_keys(plan, ask)


def _ask_graph(plan: Plan, ask: Ask) -> None:
    if not plan.masses:
        plan.masses = _masses(ask("masses in kg, such as m1=5, m2=3", ""))
    for kind in ("spring", "damper"):
        if plan.elements.get(kind) is None:
            answer = ask(
                f"{kind}s, such as a=ground,m1 b=m1,m2; empty for a chain from ground, none for none", ""
            )
            plan.elements[kind] = links_of(answer.split(), kind)


def _channels(ask: Ask, kind: str | None) -> list[Signal]:
    """Ask for channels until an answer is empty."""
    found = []
    shape = "[NAME=]QUANTITY@MASS[:UNIT[:FIELD]], such as x1=displacement@m1:mm"
    if kind is not None:
        shape = "[NAME=]QUANTITY[@PLACE][:UNIT[:FIELD]], such as u=voltage:V"
    while answer := ask(f"channel {shape}; empty ends", ""):
        found.append(channel_of(answer, kind))
    return found


def _masses(answer: str) -> dict[str, float]:
    parts = [part.strip() for part in answer.split(",") if part.strip()]
    named = [part if "=" in part else f"m{number}={part}" for number, part in enumerate(parts, 1)]
    return dict(mass_of(part) for part in named)


def _one_of(ask: Ask, question: str, known: tuple[str, ...]) -> str:
    answer = ask(question, NONE)
    if answer not in known:
        raise UsageError.at("bus", f'"{answer}" is none', f"choose one of {', '.join(known)}")
    return answer


def _ask_keys(plan: Plan, ask: Ask) -> None:
    """Ask for the driver's keys that are missing, until none is or an answer stays empty."""
    for key, question, default in QUESTIONS.get(plan.bus or "", ()):
        if plan.keys.get(key) is None:
            plan.keys[key] = ask(question, default)
    asked: set[str] = set()
    while keys := [
        fault for fault in plan.missing() if _key(fault.path) not in asked | {"rate", "mass", "channel"}
    ]:
        key = _key(keys[0].path)
        asked.add(key)
        plan.keys[key] = ask(f"{key} ({keys[0].advice})", "")
    if plan.bus and plan.counter is None and not plan.keys.get("ring"):
        plan.counter = ask("field that counts the samples; empty where there is none", "") or None


def _key(flag: str) -> str:
    return flag.rsplit(maxsplit=1)[-1].removeprefix("--")
