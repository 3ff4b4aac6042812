"""How long a certificate is good: an authority that refuses an expired one seldom says why."""

import re
import ssl
from datetime import UTC, datetime
from pathlib import Path

from agent.clock import wall_ns
from agent.northbound.interface.peer import PeerError

_TIME = rb"(?:\x17\x0d(\d{12})Z|\x18\x0f(\d{14})Z)"
_VALIDITY = re.compile(rb"\x30." + _TIME + _TIME, re.DOTALL)
"""Validity ::= SEQUENCE { notBefore Time, notAfter Time }, UTCTime or GeneralizedTime (RFC 5280, 4.1.2.5)."""


def refuse_expired(file: Path) -> None:
    """Raise PeerError where the first certificate of a PEM file has expired."""
    end = expiry(file.read_text(encoding="utf-8"))
    now = datetime.fromtimestamp(wall_ns() / 1e9, UTC)
    if end is not None and end < now:
        raise PeerError("certificate", f"{file}: the certificate has expired on {end:%Y-%m-%d %H:%M} UTC")


def expiry(text: str) -> datetime | None:
    """Return when the first certificate of a PEM text expires; None where that cannot be read."""
    begin, end = "-----BEGIN CERTIFICATE-----", "-----END CERTIFICATE-----"
    _, _, rest = text.partition(begin)
    body, is_whole, _ = rest.partition(end)
    found = _VALIDITY.search(ssl.PEM_cert_to_DER_cert(f"{begin}{body}{end}\n")) if is_whole else None
    if found is None:
        return None
    short, long = found[3], found[4]
    if short is None:
        return datetime.strptime(long.decode(), "%Y%m%d%H%M%S").replace(tzinfo=UTC)
    return datetime.strptime(short.decode(), "%y%m%d%H%M%S").replace(tzinfo=UTC)
