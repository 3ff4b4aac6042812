"""What a recording says of itself, whatever its form."""

from dataclasses import dataclass
from typing import Any, Self


@dataclass(frozen=True, slots=True)
class RawHeader:
    """Where a recording comes from; created_ns is wall time and only labels.

    Raises TypeError, KeyError when made of facts that are not a header's.
    """

    source: str
    fields: tuple[str, ...]
    counter_modulus: int | None
    config_sha256: str
    code_version: str
    created_ns: int
    byte_order: str = "little"
    rig: str = ""

    @classmethod
    def of(cls, facts: dict[str, Any]) -> Self:
        """Make a header of what was read from a file."""
        return cls(**{**facts, "fields": tuple(facts["fields"])})
