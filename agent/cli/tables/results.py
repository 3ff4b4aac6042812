"""Tables of what `replay`, `run` and `demo` found, from the documents of the JSON interface."""

import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from shlex import quote
from typing import Any

from agent.cli.terminal.output import print_table, show
from agent.text import interval, number, short_time, with_sd

Document = Mapping[str, Any]


def print_results(document: Document) -> None:
    """Print one run's document, or one after the other where `runs` holds several."""
    for run in document.get("runs", [document]):
        show(f"rig {run['rig']}: {_span(run)}")
        _print_estimates(run)
        _print_alarms(run)
        _print_samples(run)
        _print_queries(run)


def print_demo(document: Document) -> None:
    """Print what the agent found beside what was played."""
    show(f"{document.get('bus', '')}, scenario {document.get('scenario', '')}: {_span(document)}")
    show(
        "A simulated rig wore in steps; the agent, another process, "
        "knew its drawing and what came over the bus."
    )
    for segment in document.get("truth", []):
        _print_segment(segment, _units(document))
    if document.get("truth"):
        show("best possible sd: what the noise allows any method in that window (Cramér-Rao)")
    _print_alarms(document)
    if document.get("alarms"):
        show("UNACK: the limit is exceeded, nobody acknowledged it; RTNUN: it returned to normal since")
    _print_delays(document)
    _print_samples(document)
    _print_queries(document)


def _span(run: Document) -> str:
    parts = [f"{number(run.get('span_s'))} s of samples"]
    if run.get("samples_per_s"):
        parts.append(f"in {number(run.get('seconds'), 3)} s ({run['samples_per_s']:,.0f} samples a second)")
    return " ".join(parts)


def _units(document: Document) -> dict[str, str]:
    return {name: found.get("unit") or "" for name, found in document.get("estimates", {}).items()}


def _print_estimates(run: Document) -> None:
    if not run.get("estimates"):
        show("no estimates: not one hop of samples was whole")
        return
    columns = ("parameter", "value ± sd", "unit", "95 %", "change", "status", "valid rows")
    rows = (
        (
            name,
            with_sd(found.get("value"), found.get("sd")),
            found.get("unit") or "",
            interval(found.get("lower"), found.get("upper")),
            number(found.get("delta"), 4),
            verdict(found),
            f"{found.get('n_valid', 0)} of {found.get('n_rows', 0)}",
        )
        for name, found in run.get("estimates", {}).items()
    )
    print_table("last estimates", columns, rows, right=columns[1:2] + columns[3:5])


def _print_segment(segment: Document, units: Mapping[str, str]) -> None:
    columns = ("parameter", "true", "estimate ± sd", "unit", "best possible sd", "error / sd")
    rows = (
        (
            name,
            number(found.get("true")),
            with_sd(found.get("estimate"), found.get("sd")),
            units.get(name, ""),
            number(found.get("bound_sd"), 3),
            _signed(found.get("error_sd")),
        )
        for name, found in segment["parameters"].items()
    )
    title = f"{number(segment['from_s'])} s to {number(segment['to_s'])} s, last window"
    print_table(title, columns, rows, right={"true", "estimate ± sd", "best possible sd", "error / sd"})


def _print_alarms(run: Document) -> None:
    alarms = run.get("alarms", [])
    if not alarms:
        show("no alarms")
        return
    columns = ("raised", "cleared", "priority", "state", "what")
    rows = (
        [short_time(alarm.get("raised_at")), short_time(alarm.get("cleared_at"))]
        + [str(alarm.get(key) or "") for key in ("priority", "state")]
        + [
            f"{alarm['message']}; {alarm['advice']}"
            if alarm.get("advice")
            else str(alarm.get("message") or "")
        ]
        for alarm in alarms
    )
    print_table("alarms", columns, rows)


def _print_delays(document: Document) -> None:
    for delay in document.get("alarm_delays", []):
        changed, raised = delay.get("changed_s"), delay.get("raised_s")
        if raised is None:
            show(f"{delay['parameter']} changed at {number(changed)} s: not alarmed")
        else:
            lag = number(delay.get("delay_s"), 4)
            show(
                f"{delay['parameter']} changed at {number(changed)} s: "
                f"alarm at {number(raised)} s, {lag} s later"
            )


def _print_samples(run: Document) -> None:
    show("samples: " + ", ".join(_ledger(run.get("samples", {}))))


def _ledger(samples: Document) -> Iterator[str]:
    for key in ("received", "used"):
        yield f"{samples.get(key, 0)} {key}"
    for key in ("rejected", "dropped"):
        reasons = samples.get(key) or {}
        named = ", ".join(f"{count} {reason}" for reason, count in reasons.items() if count)
        yield f"{sum(reasons.values())} {key}" + (f" ({named})" if named else "")
    gaps = samples.get("gaps", 0)
    yield f"{gaps} gap{'' if gaps == 1 else 's'}"


def _print_queries(run: Document) -> None:
    db = run.get("db")
    if not db:
        show("nothing was kept; --db FILE keeps it")
        return
    file = quote(str(db))
    asked = [f"alarms {file}"]
    for name in map(quote, list(run.get("estimates", {}))[:1]):
        asked = [f"estimates {file} --parameter {name}", *asked, f"trend {file} {name}"]
    lines = [f"{_program()} {words}" for words in asked]
    sql = f"sqlite3 -readonly {file} 'select time, parameter, value, sd, status from v_latest'"  # noqa: S608 shown only
    sys.stdout.write("\nask the file:\n" + "".join(f"  {line}\n" for line in (*lines, sql)))


def _program() -> str:
    """How this program is called again from where the user is: by its name where that is found."""
    called = Path(sys.argv[0])
    if shutil.which("deltak") or called.name != "deltak":
        return "deltak"
    return quote(str(called))


def verdict(row: Document) -> str:
    """Return status and reason in words, with the value that is held where there is one."""
    words = str(row.get("status") or "-")
    if row.get("reason"):
        words += f" ({row['reason']})"
    if row.get("held") is not None:
        words += f", held {number(row['held'])} since {number(row.get('held_age_s'), 3)} s"
    return words


def _signed(value: float | None) -> str:
    return "-" if value is None else f"{value:+.2f}"
