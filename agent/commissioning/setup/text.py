"""A plan as the commented text of a configuration file."""

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from agent.commissioning.setup.plan import ELEMENTS, Link, Plan, Signal, fields_of, number_of, place_of
from agent.commissioning.setup.template import watched
from agent.commissioning.tuning import HOP_SAMPLES, SLOW_HZ

_CLOCKS = {
    "counter": "the device numbers its samples; a missing number is a gap",
    "device": "samples carry time stamps of the kernel, of the device or of the recording",
    "arrival": "nothing numbers the samples: they are ordered by when they come",
}


def text_of(plan: Plan) -> str:
    """Return the file's text; lines end with a newline."""
    parts = (
        _head(plan),
        _rig(plan),
        _model(plan),
        _channels(plan.channels, known=plan.kind in (None, "linear")),
        _rest(plan),
        _source(plan),
        _store(plan),
    )
    return "\n".join(line for part in parts for line in part) + "\n"


def value_of(value: Any) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {value_of(item)}" for key, item in value.items()) + " }"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(value_of(item) for item in value) + "]"
    if isinstance(value, bool | str):
        return json.dumps(value, ensure_ascii=False)
    return repr(value)


def _head(plan: Plan) -> Iterator[str]:
    yield f"# {plan.name}: written by deltak init. Every key is explained in docs/configuration.md."
    yield "# What follows, in this order:"
    if plan.bus:
        yield "#     deltak listen FILE                  shows what comes over the bus and what it decodes to"
    found = "better nominals than those below" if plan.kind else "every nominal that is missing below"
    yield f"#     deltak identify FILE RECORDING --write     finds {found}"
    yield "#     deltak run FILE                     watches the machine"


def _rig(plan: Plan) -> Iterator[str]:
    clock = clock_of(plan)
    yield from ("", "[rig]", f"name = {value_of(plan.name)}")
    yield f"sample_rate_hz = {value_of(plan.rate_hz)}"
    yield f'clock = "{clock}"'.ljust(34) + f" # {_CLOCKS[clock]}"


def clock_of(plan: Plan) -> str:
    """Return what orders the samples of a plan's bus."""
    counted = plan.counter is not None or bool(plan.keys.get("ring"))
    if counted and plan.bus:
        return "counter"
    return "arrival" if plan.bus in ("serial", "modbus") else "device"


def _model(plan: Plan) -> Iterator[str]:
    if plan.kind is not None:
        yield from _template(plan.kind, plan.model)
        return
    yield from ("", "[model]", 'kind = "mass-spring-damper"')
    yield "# masses in kg; sd_percent is how well each is known (2 % where nothing is said)"
    yield from _rows("mass", [{"name": name, "value": value} for name, value in plan.masses.items()])
    if any(link.nominal is None for kind in ELEMENTS for link in plan.links(kind)):
        yield "# what has no nominal is found by deltak identify; run wants all of them"
    for kind in ELEMENTS:
        yield from _rows(kind, [_link(link) for link in plan.links(kind)])


def _template(kind: str, model: Mapping[str, Any]) -> Iterator[str]:
    """Yield a template's own keys, in SI units; docs/configuration.md says which."""
    yield from ("", "[model]", f"kind = {value_of(kind)}".ljust(34) + " # its elements in SI units")
    for key, value in model.items():
        if isinstance(value, list):
            yield from _rows(key, value)
        else:
            yield f"{key} = {value_of(value)}"


def _link(link: Link) -> dict[str, Any]:
    known = {} if link.nominal is None else {"nominal": link.nominal}
    return {"name": link.name, "between": list(link.between)} | known


def _rows(key: str, tables: Sequence[Any]) -> Iterator[str]:
    if not tables:
        return
    yield f"{key} = ["
    yield from (f"    {value_of(table)}," for table in tables)
    yield "]"


def _channels(channels: Sequence[Signal], *, known: bool) -> Iterator[str]:
    """Yield channels; known: what drives the model shows in the quantity."""
    for channel in channels:
        drives = channel.quantity in ("force", "input")
        words = "drives the model: an input" if drives else "what is measured: an output"
        yield from ("", "[[channel]]".ljust(34) + f" # {words}" if known else "[[channel]]")
        yield f"name = {value_of(channel.name)}"
        yield f"quantity = {value_of(channel.quantity)}"
        if channel.at:
            yield f"at = {value_of(channel.at)}"
        yield (
            f"unit = {value_of(channel.unit)}".ljust(34) + " # after scale and offset, where these are given"
        )


def _rest(plan: Plan) -> Iterator[str]:
    yield from ("", "[estimator]")
    yield 'window_s = "auto"'.ljust(34) + " # each estimate rests on so much; a number of seconds fixes it"
    if plan.rate_hz is not None and plan.rate_hz < SLOW_HZ:
        yield f"hop_s = {value_of(HOP_SAMPLES / plan.rate_hz)}".ljust(34) + " # a row of estimates so often"
    yield "# An alarm where a parameter leaves its healthy value by more than a limit:"
    if any(link.nominal is None for link in plan.links("friction")):
        names = [link.name for kind in ELEMENTS for link in plan.links(kind)]
        yield f"estimate = {value_of(names)}"
    first = next((link.name for kind in ELEMENTS for link in plan.links(kind)), "k1")
    yield "# [[alarm]]"
    yield f"# parameter = {value_of(watched(plan.kind, plan.model) if plan.kind else first)}"
    yield "# limit_percent = 20.0"


def _source(plan: Plan) -> Iterator[str]:
    if plan.bus is None:
        yield from ("", "# No bus: recordings (CSV, NPZ) name their columns t and the channels' names.")
        yield '# [columns]                        # where they are called otherwise: x1 = "Encoder 1"'
        return
    yield from ("", "[[source]]", f"driver = {value_of(plan.bus)}")
    yield from (f"{key} = {value_of(value)}" for key, value in keys_of(plan).items())
    mapped = {channel.name: channel.field for channel in plan.channels}
    yield f"map = {value_of(mapped)}".ljust(34) + " # channel = field of the bus"
    if plan.counter is not None:
        yield f"counter = {value_of(plan.counter)}"


def _store(plan: Plan) -> Iterator[str]:
    yield from ("", "[store]", f"path = {value_of(f'{plan.name}.db')}")


def keys_of(plan: Plan) -> dict[str, Any]:
    """Return the driver's own keys."""
    given = {key: value for key, value in plan.keys.items() if value not in (None, "")}
    return {"can": _can, "serial": _serial, "modbus": _modbus}[plan.bus or ""](given)


def _can(given: Mapping[str, Any]) -> dict[str, Any]:
    daemon = {"host": given["host"]} if "host" in given else {}
    daemon |= {"port": int(given["port"])} if "port" in given else {}
    interface = given.get("interface", "socketcand" if daemon else "socketcan")
    return {"interface": interface, **daemon, "channel": given.get("channel", "can0"), "dbc": given["dbc"]}


def _serial(given: Mapping[str, Any]) -> dict[str, Any]:
    keys = {"port": given["port"]} | _baud(given)
    if "columns" in given:
        keys |= {"format": "text", "columns": [name.strip() for name in given["columns"].split(",")]}
        return keys | ({"checksum": given["checksum"]} if "checksum" in given else {})
    keys |= {"format": "binary", "sync": given["sync"], "fields": fields_of(given["fields"])}
    return keys | ({"crc": given["crc"]} if "crc" in given else {})


def _baud(given: Mapping[str, Any]) -> dict[str, int]:
    return {"baudrate": int(number_of(str(given["baudrate"]), "--baudrate"))} if "baudrate" in given else {}


def _modbus(given: Mapping[str, Any]) -> dict[str, Any]:
    port = str(given.get("port", "502"))
    keys: dict[str, Any] = {"transport": "tcp", "host": given.get("host", "127.0.0.1"), "port": 502}
    if port.isdigit():
        keys["port"] = int(port)
    else:
        keys = {"transport": "rtu", "port": port} | _baud(given)
    keys |= {"device_id": given["device_id"]} if "device_id" in given else {}
    keys["mode"] = "ring" if "ring" in given else "poll"
    if "ring" in given:
        keys["index"] = place_of(given["index"], "--index", "type", "uint32")
        keys["ring"] = place_of(given["ring"], "--ring", "slots")
    return keys | {"fields": fields_of(given["fields"])}
