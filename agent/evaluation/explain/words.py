"""The sentences of an explanation."""

from collections.abc import Mapping
from typing import Any

from agent import __version__
from agent.evaluation.explain.tested import Rival, Tested
from agent.text import counted, iso_time, number, percent, with_local, with_sd
from agent.types import Verdict

Row = Mapping[str, Any]


def stored(alarm: Row) -> str:
    """Say what moved, by how much, and how sure that was."""
    said = f"Alarm {alarm['id']}: {alarm['message']}, raised at {with_local(alarm['raised_at'])}."
    if alarm["probability"] is None:
        return said
    limit = number(alarm["limit_value"])
    return f"{said} It is beyond {limit} with a probability of {_sure(alarm['probability'])}."


def compared(alarm: Row, found: Row | None, digits: int, *, same: bool) -> str:
    """Say whether the samples lead to the same verdict."""
    if found is None:
        return "The samples of its record do not raise this alarm: it rests on something else than samples."
    if same:
        how = "to the last digit" if digits >= 17 else f"to {digits} digits"
        return f"Computed again from its samples the verdict is the same, {how}."
    again = (
        f"{number(found['delta'])} ± {number(found['sd'])}"
        if found["delta"] is not None
        else found["message"]
    )
    agree = f"{digits} digits agree" if alarm["delta"] is not None else "the words differ"
    return f"Computed again from its samples it is another verdict: {again}; {agree}."


def version(recorded: str) -> list[str]:
    """Say which other version made the alarm."""
    if recorded == __version__:
        return []
    return [f"It was raised by version {recorded}, this is {__version__}: what differs may be theirs."]


def configuration(stored_sha256: str, used_sha256: str) -> list[str]:
    """Say that a record is of another configuration."""
    if stored_sha256 == used_sha256:
        return []
    return [f"Its run had the configuration {stored_sha256[:12]}, its record has {used_sha256[:12]}."]


def rivals(seen: Tested) -> list[str]:
    """Say what else was tested, and how it lost."""
    others = [_rival(one) for one in seen.parameters[1:]]
    said = [f"At the same instant {'; '.join(others)}."] if others else []
    if not seen.constants:
        return [*said, "No doubt of a mass, a gain or a delay stood then."]
    return [*said, f"Of the rig's constants was believed: {'; '.join(map(_constant, seen.constants))}."]


def samples(record: Row, seen: Tested) -> str:
    """Say which samples the verdict rests on."""
    start, end = with_local(iso_time(record["from_ns"])), with_local(iso_time(record["to_ns"]))
    said = f"Its record {record['file']} holds {counted(record['samples'], 'sample')} from {start} to {end}"
    if seen.n_used is None:
        return f"{said}."
    lost = f", {seen.n_missing} lost" if seen.n_missing else ""
    window_s = number(seen.window_s)
    return f"{said}; the verdict rests on the {seen.n_used} of the last {window_s} s before it{lost}."


def no_record(kind: str) -> str:
    """Say why there are no samples of an alarm."""
    if kind == "live":
        return (
            "No samples were kept around it: "
            "records were switched off, or too many were made within the hour."
        )
    return f"A {kind} keeps no samples: replay the recording again, or explain an alarm of a live run."


def gone(state: str, message: str) -> str:
    """Say that a record is not there any more."""
    why = "made room for newer ones" if state == "purged" else f"could not be kept ({message})"
    return f"The samples around it {why}: it cannot be computed again."


def removed(file: str) -> str:
    """Say that somebody took a record's file away."""
    return f"Its record {file} is not beside the database any more: it cannot be computed again."


def unusable(file: str, why: str) -> str:
    """Say why a record cannot be computed again."""
    return f"Its record {file} cannot be computed again: {why}."


def _rival(one: Rival) -> str:
    size = f"{one.name} had changed by {with_sd(one.delta, one.sd)} {one.unit}".rstrip()
    if one.status != "valid":
        return f"{one.name} was {one.status}"
    if one.limit is None or one.probability is None:
        return size
    return f"{size}, beyond its limit {number(one.limit)} with {_sure(one.probability)}"


def _constant(one: Verdict) -> str:
    unit = "" if one.unit == "1" else f" {one.unit}"
    return f"{one.hypothesis} off by {with_sd(one.size, one.sd)}{unit} with {_sure(one.probability)}"


def _sure(probability: float) -> str:
    """Write a probability; what rounds to certainty is said not to be it."""
    if probability > 0.9995:
        return "over 99.9 %"
    return "under 0.1 %" if probability < 0.001 else percent(probability)
