"""What must hold in [[north]]: keys each kind needs and has, addresses without secrets, names that fit."""

import math
import re
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Final
from urllib.parse import SplitResult, parse_qsl, urlsplit

from agent.config.draft import Draft
from agent.config.reading.fields import shown
from agent.config.reading.messages import join, listing
from agent.config.reading.parse import readable, unique
from agent.config.reading.secrets import is_vague
from agent.config.sections.north import North
from agent.errors import Fault

SCHEMES: Final = {
    "mqtt": ("mqtt", "mqtts"), "sparkplug": ("mqtt", "mqtts"), "postgres": ("postgresql", "postgres"),
}  # fmt: skip
"""Of the addresses of a kind; the second of MQTT is over TLS."""
_LINE: Final = ("url", "prefix", "user", "password", "ca", "cert", "key")
_OWN: Final = {
    "mqtt": (*_LINE, "client_id", "discovery"),
    "sparkplug": (*_LINE, "client_id", "node", "primary_host"),
    "postgres": _LINE,
    "parquet": ("folder", "every"),
}
"""Keys that not every kind has."""
_LIBRARY: Final = {
    "mqtt": ("paho.mqtt", "mqtt"), "sparkplug": ("paho.mqtt", "mqtt"), "postgres": ("psycopg", "postgres"),
    "parquet": ("pyarrow", "parquet"),
}  # fmt: skip
"""What a kind imports, and the extra that brings it."""
_PREFIX: Final = {
    "mqtt": (re.compile(r"[^+#$\x00][^+#\x00]*"), "a topic without + and #"),
    "sparkplug": (re.compile(r"[^+#/$\x00]+"), "a group's name without +, # and /"),
    "postgres": (
        re.compile(r"([a-z_][a-z0-9_]{0,40}\.)?[a-z_][a-z0-9_]{0,40}"),
        'such as "deltak" or "plant.deltak"',
    ),
}


def check_north(draft: Draft) -> None:
    """Note the faults of consumers."""
    unique(draft.north, draft.faults)
    for path, consumer in draft.north:
        if readable(consumer.name, consumer.kind):
            draft.faults.found += _faults(path, consumer)
            draft.faults.found += _unknown_parameters(path, consumer, draft)


def _faults(path: str, consumer: North) -> Iterator[Fault]:
    needed = "folder" if consumer.kind == "parquet" else "url"
    if needed not in consumer.model_fields_set:
        yield Fault(join(path, needed), "is missing", f'kind = "{consumer.kind}" needs it')
    if consumer.every == math.inf:
        yield Fault(join(path, "every"), "must be a time, not for ever", 'write "1d"')
    yield from _strange_keys(path, consumer)
    if is_vague(consumer.password):
        yield Fault(
            join(path, "password"), "must name one place", '{ file = "..." } or { credential = "..." }'
        )
    if consumer.cert is not None and consumer.key is None:
        yield Fault(join(path, "key"), "is missing", "a client certificate needs the file of its private key")
    library, extra = _LIBRARY[consumer.kind]
    if not _is_installed(library):
        yield Fault(
            join(path, "kind"), f"needs {library}, which is not installed", f"pip install 'deltak[{extra}]'"
        )
    yield from _address_faults(join(path, "url"), consumer)
    yield from _prefix_faults(join(path, "prefix"), consumer)


def _strange_keys(path: str, consumer: North) -> Iterator[Fault]:
    """Keys that belong to consumers of another kind."""
    strange = sorted(
        consumer.model_fields_set & {k for keys in _OWN.values() for k in keys} - {*_OWN[consumer.kind]}
    )
    for key in strange:
        owners = listing(kind for kind, keys in _OWN.items() if key in keys)
        yield Fault(join(path, key), f"belongs to kind = {owners}", "leave it out, or change the kind")


def _prefix_faults(path: str, consumer: North) -> Iterator[Fault]:
    if consumer.kind in _PREFIX and readable(consumer.prefix):
        pattern, wanted = _PREFIX[consumer.kind]
        if not pattern.fullmatch(consumer.prefix):
            yield Fault(path, f"{shown(consumer.prefix)} is none", wanted)


def _address_faults(path: str, consumer: North) -> Iterator[Fault]:
    schemes = SCHEMES.get(consumer.kind)
    if schemes is None or consumer.url is None:
        return
    found = _parted(consumer.url)
    if found is None or found.scheme not in schemes:
        yield Fault(path, "is no address of this kind", f'write "{schemes[0]}://host"')
        return
    if _holds_password(found):
        yield Fault(path, "holds a password", 'name where it is: password = { file = "..." }')
    elif found.scheme == "mqtt" and consumer.ca is not None:
        yield Fault(path, "is without TLS, though a ca is named", 'write "mqtts://host"')


def _holds_password(address: SplitResult) -> bool:
    """Tell whether there is a password in an address, also where only other libraries see one."""
    keys = (key.lower() for key, _ in parse_qsl(address.query, keep_blank_values=True))
    is_hidden = "@" in address.path + address.fragment
    return address.password is not None or is_hidden or any("password" in key for key in keys)


def _parted(url: str) -> SplitResult | None:
    """Return an address taken apart; None for none."""
    try:
        found = urlsplit(url)
        is_local = found.scheme.startswith("postgres")
        is_whole = (is_local or bool(found.hostname)) and found.port != 0
    except ValueError:
        return None
    return found if is_whole else None


def _unknown_parameters(path: str, consumer: North, draft: Draft) -> Iterator[Fault]:
    known = draft.estimated
    for name in consumer.parameters or ():
        if known and name not in known:
            yield Fault(
                join(path, "parameters"), f"{shown(name)} is not estimated", f"estimated are {listing(known)}"
            )


def _is_installed(library: str) -> bool:
    try:
        return find_spec(library) is not None
    except ModuleNotFoundError:
        return False
