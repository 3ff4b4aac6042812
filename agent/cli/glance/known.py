"""What could be known of parameters now: how far the motion of the newest window resolves each, in words."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from agent.text import number

Row = Mapping[str, Any]
_REASONS: Final[Mapping[str, str]] = {
    "changing": "it changes within the window",
    "mismatch": "the model does not explain the motion",
    "sensor": "a channel is at fault",
    "diverged": "the fit did not converge",
    "gap": "samples are missing",
    "no data": "no samples come",
    "dry friction": "dry friction that the model has no term for",
    "stuck": "a channel stands still",
    "saturated": "a channel is at the end of its range",
    "standstill": "nothing moves",
    "realigning": "the sources are being aligned anew",
}
_UNEXCITED: Final = "this motion does not resolve it"
_WARMING: Final = "the first window is not full yet"


def known_now(row: Row, limit: float | None) -> dict[str, Any]:
    """Return {"resolved", "half_width", "of_limit", "words"} of a row of v_latest.

    half_width: half of the 95 % interval of the newest window, in the parameter's unit; of_limit: its share
    of the limit. Both are None where there is no interval, or no limit.
    """
    half = _half_width(row)
    resolved = row["status"] == "valid"
    share = half / limit if limit and half is not None else None
    words = _words(row, half, share) if resolved else _why(row, half, share)
    return {"resolved": resolved, "half_width": half, "of_limit": share, "words": words}


def _half_width(row: Row) -> float | None:
    ends = row["lower"], row["upper"]
    return None if None in ends else float(ends[1] - ends[0]) / 2.0


def _words(row: Row, half: float | None, share: float | None) -> str:
    width = "" if half is None else f" to ± {_with_unit(half, row)}"
    return f"known{width}{_of_limit(share)}"


def _why(row: Row, half: float | None, share: float | None) -> str:
    width = f"; ± {_with_unit(half, row)}{_of_limit(share)}" if half is not None else ""
    return f"not known: {reason_words(row)}{width}"


def reason_words(row: Row) -> str:
    """Say why the newest row of a parameter is not valid."""
    status = str(row["status"])
    reason = row["reason"]
    if reason is None:
        return {"unexcited": _UNEXCITED, "warming": _WARMING}.get(status, status)
    return _REASONS.get(reason, str(reason))


def _with_unit(half: float, row: Row) -> str:
    return f"{number(half, 2)} {'' if row['unit'] in {None, '1'} else row['unit']}".rstrip()


def _of_limit(share: float | None) -> str:
    """Say how much of the limit that is: in per cent, or how many times where it is more."""
    if share is None:
        return ""
    size = (
        f"{number(share, 2)} times its limit"
        if share >= 2.0
        else f"{number(100.0 * share, 2)} % of its limit"
    )
    return f", {size}"


def known_words(parameters: Sequence[Row]) -> str:
    """Say of a rig which parameters the motion resolves now, and why it does not resolve others.

    parameters: of the overview, each with `known`.
    """
    resolved = [row["parameter"] for row in parameters if row["known"]["resolved"]]
    others: dict[str, list[str]] = {}
    for row in parameters:
        if not row["known"]["resolved"]:
            others.setdefault(reason_words(row), []).append(row["parameter"])
    parts = [f"resolved now: {_listed(resolved)}"] if parameters else []
    return "; ".join([*parts, *(f"not {_listed(names)}: {why}" for why, names in others.items())])


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names) or "nothing"
