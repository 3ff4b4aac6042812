"""`deltak score`: scenarios played from end to end on simulated time, and held against what they expect."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from agent.errors import UsageError
from agent.evaluation.score.measures import Assessment
from agent.evaluation.score.play import open_bench, play, shipped

Report = Callable[[str, float], None]


class Expect(BaseModel):
    """[expect] of a scenario; what it omits is not tested, but that the ledger balances and no row is spoilt.

    Attributes:
        rms_sd, covered_percent, rms_percent: of every parameter's error (most, least, most).
        valid_percent: least share of valid estimates.
        delay_s: the longest time from an excursion to its alarm.
        missed, false: alarms.
        lost: samples played of which nothing was used, at most.
        gaps: places where samples are missing, exactly.
        recovery_s: the longest time from a fault's end until samples come.
        events: the causes of the sources' health events, exactly, in order.
        sensors: channels with a sensor alarm, exactly.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    rms_sd: float | None = None
    rms_percent: float | None = None
    covered_percent: float | None = None
    valid_percent: float | None = None
    delay_s: float | None = None
    missed: int | None = None
    false: int | None = None
    lost: int | None = None
    gaps: int | None = None
    recovery_s: float | None = None
    events: tuple[str, ...] | None = None
    sensors: tuple[str, ...] | None = None


def score(scenarios: Sequence[str], faults: Sequence[str], report: Report) -> dict[str, Any]:
    """Score scenarios, all that ship if none is named; `report` is called with each name and the share done.

    Raises UsageError, ConfigError, ModelError, and what the simulator raises.
    """
    found = [_scored(name, faults, report) for name in scenarios or shipped()]
    return {"scenarios": found, "ok": all(entry["ok"] for entry in found)}


def _scored(name: str, faults: Sequence[str], report: Report) -> dict[str, Any]:
    bench = open_bench(name, faults)
    expect = _expectation(name, bench.expect)
    assess = Assessment(play(bench, lambda share: report(name, share)), bench.strikes())
    measures = assess.document()
    failures = _failures(expect, measures)
    return {
        "scenario": name,
        "seconds": bench.duration_s,
        "ok": not failures,
        "failures": failures,
        **measures,
    }


def _expectation(name: str, content: Mapping[str, Any]) -> Expect:
    try:
        return Expect.model_validate(content)
    except ValidationError as error:
        keys = ", ".join(Expect.model_fields)
        words = "; ".join(
            f"expect.{'.'.join(map(str, fault['loc']))}: {fault['msg']}" for fault in error.errors()
        )
        raise UsageError.at(name, words, f"the keys of [expect] are {keys}") from error


def _failures(expect: Expect, found: Mapping[str, Any]) -> list[str]:
    """Return in words what is not as expected."""
    errors = [error for error in found["parameters"].values() if error["rows"]]
    excursions = [one["delay_s"] for one in found["alarms"]["excursions"] if one["delay_s"] is not None]
    recoveries = [_number(one["recovery_s"]) for one in found["faults"]]
    checks = [
        _most("rms_sd", expect.rms_sd, [error["rms_sd"] for error in errors]),
        _most("rms_percent", expect.rms_percent, [error["rms_percent"] for error in errors]),
        _least("covered_percent", expect.covered_percent, [error["covered_percent"] for error in errors]),
        _least("valid_percent", expect.valid_percent, [_number(found["valid_percent"], -1.0)]),
        _most("delay_s", expect.delay_s, excursions),
        _most("missed", expect.missed, [len(found["alarms"]["missed"])]),
        _most("false", expect.false, [len(found["alarms"]["false"])]),
        _most("lost", expect.lost, [found["samples"]["lost"]]),
        _most("recovery_s", expect.recovery_s, recoveries),
        _same("gaps", expect.gaps, found["samples"]["gaps"]),
        _same("events", expect.events, tuple(cause for _, cause in found["events"])),
        _same("sensors", expect.sensors, tuple(found["sensors"])),
        _same("spoilt_rows", 0, found["spoilt_rows"]),
        _same("balanced", True, found["samples"]["balanced"]),
    ]
    return [words for words in checks if words]


def _number(value: float | None, none: float = float("inf")) -> float:
    return none if value is None else value


def _most(key: str, limit: float | None, values: Sequence[float]) -> str:
    worst = max(values, default=0.0)
    return "" if limit is None or worst <= limit else f"{key}: {worst:.4g} is more than {limit:g}"


def _least(key: str, limit: float | None, values: Sequence[float]) -> str:
    worst = min(values, default=float("inf"))
    return "" if limit is None or worst >= limit else f"{key}: {worst:.4g} is less than {limit:g}"


def _same(key: str, wanted: object, value: object) -> str:
    return "" if wanted is None or value == wanted else f"{key}: {value} is not {wanted}"
