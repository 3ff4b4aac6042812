"""The command line. Each command imports what it needs when it runs, so that `deltak --help` answers at once.

Command bodies return the documents of the JSON interface as plain dicts and print nothing; this module prints them,
turns errors into lines and exit codes, and knows no more.
"""

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from agent import __version__
from agent.cli.group import CommandGroup
from agent.cli.terminal.signals import done_when_terminated

if TYPE_CHECKING:
    from agent.alarms.life_cycle import Cause

app = typer.Typer(
    name="deltak",
    cls=CommandGroup,
    help="Estimate stiffness and damping of a structure over its field bus, and alarm when they leave their limits.",
    epilog="Exit codes: 0 done, 1 unforeseen, 2 usage or configuration, 3 database, 4 bus, 130 interrupted.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)


class Bus(StrEnum):
    """The buses that the demo can play."""

    MODBUS = "modbus"
    CAN = "can"
    SERIAL = "serial"


class RunKind(StrEnum):
    """What a live run is marked as; the demo's parent process marks its own."""

    LIVE = "live"
    DEMO = "demo"


Json = Annotated[bool, typer.Option("--json", help="One JSON document on stdout and nothing else.")]
Csv = Annotated[bool, typer.Option("--csv", help="CSV on stdout, every digit, empty for none.")]
Config = Annotated[Path, typer.Argument(metavar="CONFIG", help="Configuration file (TOML).", show_default=False)]
Database = Annotated[Path, typer.Argument(metavar="DB", help="Database file of the agent.", show_default=False)]
NewDb = Annotated[Path | None, typer.Option("--db", metavar="FILE", help="Database to write; created if missing.")]
Rig = Annotated[str | None, typer.Option("--rig", help="Only this rig.")]
Since = Annotated[
    str | None, typer.Option("--since", metavar="T", help="ISO 8601, or an age back from the newest row: 90s, 12h, 30d")
]
Until = Annotated[str | None, typer.Option("--until", metavar="T", help="As --since; both ends belong to the answer.")]
Plot = Annotated[Path | None, typer.Option("--plot", metavar="FILE", help="Draw to FILE (.png, .svg or .pdf).")]
Duration = Annotated[float | None, typer.Option("--duration", metavar="S", min=0.0, help="Stop after S seconds.")]


@app.callback(invoke_without_command=True)
def _start(
    ctx: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
    _verbose: Annotated[
        int, typer.Option("-v", "--verbose", count=True, show_default=False, help="Log progress; -vv logs all.")
    ] = 0,
    _debug: Annotated[bool, typer.Option("--debug", help="Log all, and show tracebacks.")] = False,
) -> None:
    """Answer what needs no command; -v and --debug, taken out before, are here for the help."""
    if version:
        sys.stdout.write(f"deltak {__version__}\n")
        raise typer.Exit
    if ctx.invoked_subcommand is None:
        sys.stderr.write(ctx.get_help() + "\n")
        raise typer.Exit(2)


@app.command()
def demo(
    bus: Annotated[Bus, typer.Option(help="The bus between device and agent.")] = Bus.MODBUS,
    scenario: Annotated[str | None, typer.Option(metavar="NAME", help="A scenario that ships with deltak.")] = None,
    fast: Annotated[bool, typer.Option("--fast", help="As fast as no sample is lost, not in real time.")] = False,
    db: NewDb = None,
    json: Json = False,
) -> None:
    """Run a simulated rig and the agent end to end, and hold the estimates against the truth."""
    from agent.cli import results as commands_results
    from agent.evaluation.demo import demo as body

    document = body.demo(bus=bus.value, scenario=scenario, fast=fast, db=db)
    _answer(document, commands_results.print_demo, as_json=json)


@app.command()
def paper(
    window: Annotated[int | None, typer.Option(metavar="N", min=1, help="Samples in the window.")] = None,
    passes: Annotated[int | None, typer.Option(metavar="P", min=1, help="Passes of re-centring.")] = None,
    json: Json = False,
    plot: Plot = None,
) -> None:
    """Recompute the paper's tables 1 and 3 and its figures 3 and 4, and say what differs."""
    from agent.cli import results as commands_results
    from agent.evaluation.paper import paper as body

    document = body.paper(window=window, passes=passes, plot=plot)
    _answer(document, lambda found: commands_results.print_paper(found, body), as_json=json)


@app.command()
def check(
    config: Config,
    recording: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Judge by this recording: each channel, and the sd to expect.")
    ] = None,
    probe: Annotated[bool, typer.Option("--probe", help="Listen to the sources for 5 s and judge by that.")] = False,
    json: Json = False,
) -> None:
    """Check a configuration: faults, observability, poles, the sd to expect, advice."""
    from agent.cli import check as commands_check
    from agent.commissioning import check as body

    document = body.check(config=config, recording=recording, probe=probe)
    _answer(document, commands_check.print_check, as_json=json)
    if not document.get("ok", True):
        raise typer.Exit(commands_check.report_faults(document))


@app.command()
def run(
    configs: Annotated[list[Path], typer.Argument(metavar="CONFIG", help="Configuration files (TOML).")],
    db: NewDb = None,
    duration: Duration = None,
    json: Json = False,
    kind: Annotated[RunKind, typer.Option(hidden=True, help="What the run is marked as.")] = RunKind.LIVE,
) -> None:
    """Run the agent in the foreground until SIGTERM, SIGINT or the end of --duration."""
    from agent.cli import results as commands_results
    from agent.runtime import service

    document = service.run(configs=configs, db=db, duration_s=duration, kind=kind.value)
    _answer(document, commands_results.print_results, as_json=json)


@app.command()
def replay(
    config: Config,
    recordings: Annotated[list[Path], typer.Argument(metavar="RECORDING", help="CSV, NPZ, CAN logs, own recordings.")],
    db: NewDb = None,
    json: Json = False,
) -> None:
    """Run recordings through the same pipeline as the live agent, as fast as it goes."""
    from agent.cli import results as commands_results
    from agent.runtime import replay as body

    document = body.replay(config=config, recordings=recordings, db=db)
    _answer(document, commands_results.print_results, as_json=json)


@app.command()
def identify(
    config: Config,
    recordings: Annotated[list[Path], typer.Argument(metavar="RECORDING", help="CSV, NPZ, CAN logs, own recordings.")],
    write: Annotated[bool, typer.Option("--write", help="Put the values found into CONFIG; comments stay.")] = False,
    json: Json = False,
    plot: Plot = None,
) -> None:
    """Find springs and dampers of a graph from recordings; no nominal is needed, none is trusted."""
    from agent.cli import identify as commands_identify
    from agent.commissioning import identify as body

    document, seen = body.identify(config=config, recordings=recordings, write=write)
    if plot is not None:
        commands_identify.draw(document, seen, plot)
    _answer(document, commands_identify.print_identified, as_json=json)
    if not document["ok"]:
        raise typer.Exit(commands_identify.report_refusal(document))


@app.command()
def score(
    scenarios: Annotated[
        list[str] | None, typer.Argument(metavar="SCENARIO...", help="Scenarios that name their rig; all that ship.")
    ] = None,
    fault: Annotated[
        list[str] | None, typer.Option(metavar="F@T", help="One more fault in each, NAME@SECONDS.")
    ] = None,
    json: Json = False,
) -> None:
    """Play scenarios from end to end on simulated time, and hold what was found against what they expect."""
    from agent.cli import score as commands_score
    from agent.evaluation.score.score import score as body

    document = body(scenarios or [], fault or [], commands_score.progress())
    _answer(document, commands_score.print_score, as_json=json)
    if not document["ok"]:
        raise typer.Exit(commands_score.NOT_MET)


@app.command()
def estimates(
    db: Database,
    rig: Rig = None,
    parameter: Annotated[str | None, typer.Option(metavar="P", help="Only this parameter.")] = None,
    since: Since = None,
    until: Until = None,
    json: Json = False,
    csv: Csv = False,
) -> None:
    """List estimates with their intervals and status."""
    from agent.cli import queries as commands_queries

    commands_queries.estimates(db, rig, parameter, since, until, _form(json=json, csv=csv))


@app.command()
def alarms(
    db: Annotated[
        Path | None, typer.Argument(metavar="DB", help="Database file of the agent.", show_default=False)
    ] = None,
    rig: Rig = None,
    active: Annotated[bool, typer.Option("--active", help="Only those whose condition still stands.")] = False,
    stats: Annotated[bool, typer.Option("--stats", help="Rates, floods, chattering: the standard's measures.")] = False,
    since: Since = None,
    states: Annotated[bool, typer.Option("--states", help="The table of states and causes; needs no DB.")] = False,
    json: Json = False,
    csv: Csv = False,
) -> None:
    """List alarms, one line an activation; --since goes with --stats."""
    from agent.cli.operator import alarms as body

    form = _form(json=json, csv=csv)
    if states:
        body.print_states(as_json=json)
    elif stats:
        _answer(body.statistics(_named(db), rig, since), body.print_statistics, as_json=json)
    else:
        body.alarms(_named(db), rig, form, active=active)


Ids = Annotated[list[int], typer.Argument(metavar="ID...", help="Numbers of alarms, as deltak alarms lists them.")]
By = Annotated[str | None, typer.Option("--by", metavar="WHO", help="Who does it; the user by default.")]
Comment = Annotated[str | None, typer.Option("--comment", metavar="TEXT", help="Why.")]


@app.command()
def ack(db: Database, ids: Ids, by: By = None, comment: Comment = None, json: Json = False) -> None:
    """Acknowledge alarms: somebody knows of them."""
    _operate(db, "acknowledge", ids, (by, comment), json=json)


@app.command()
def shelve(
    db: Database,
    ids: Ids,
    length: Annotated[
        str | None, typer.Option("--for", metavar="T", help="How long, by elapsed time: 30m, 8h; at most 7d.")
    ] = None,
    by: By = None,
    comment: Comment = None,
    json: Json = False,
) -> None:
    """Silence alarms for a limited time."""
    _operate(db, "shelve", ids, (by, comment), length, json=json)


@app.command()
def unshelve(db: Database, ids: Ids, by: By = None, comment: Comment = None, json: Json = False) -> None:
    """End the shelf of alarms; one that stands is acknowledged by that."""
    _operate(db, "unshelve", ids, (by, comment), json=json)


@app.command()
def oos(db: Database, ids: Ids, by: By = None, comment: Comment = None, json: Json = False) -> None:
    """Take alarms out of service, until they are returned."""
    _operate(db, "out of service", ids, (by, comment), json=json)


@app.command("return")
def return_(db: Database, ids: Ids, by: By = None, comment: Comment = None, json: Json = False) -> None:
    """Return alarms to service; one that stands is to be acknowledged."""
    _operate(db, "return", ids, (by, comment), json=json)


notify = typer.Typer(help="Look after notifications of alarms.", no_args_is_help=True, rich_markup_mode=None)
app.add_typer(notify, name="notify")


@notify.command("list")
def notify_list(
    db: Database,
    dead: Annotated[bool, typer.Option("--dead", help="Only those that were given up.")] = False,
    json: Json = False,
    csv: Csv = False,
) -> None:
    """List what became of each notification."""
    from agent.cli.operator import notify as body

    body.listed(db, _form(json=json, csv=csv), dead=dead)


@notify.command("resend")
def notify_resend(
    db: Database,
    ids: Annotated[list[int], typer.Argument(metavar="ID...", help="Numbers that deltak notify list --dead shows.")],
    json: Json = False,
) -> None:
    """Let notifications that were given up be tried anew by the agent."""
    from agent.cli.operator import notify as body

    _answer(body.resend(db, ids), body.print_resent, as_json=json)


@notify.command("test")
def notify_test(config: Config, json: Json = False) -> None:
    """Send a test message to each target of a configuration."""
    from agent.cli.operator import notify as body

    document = body.test(config)
    _answer(document, body.print_tested, as_json=json)
    if not document["ok"]:
        raise typer.Exit(2)


@app.command()
def explain(
    db: Database,
    alarm: Annotated[int, typer.Argument(metavar="ID", help="Number of an alarm, as deltak alarms lists it.")],
    plot: Plot = None,
    json: Json = False,
) -> None:
    """Compute an alarm's verdict again from the samples kept around it, and say in words what it rests on."""
    from agent.cli.operator import explain as body

    _answer(body.explain(db, alarm, plot), body.print_explained, as_json=json)


@app.command()
def records(db: Database, rig: Rig = None, json: Json = False, csv: Csv = False) -> None:
    """List the raw samples that were kept around alarms; deltak replay reads the files."""
    from agent.cli import queries as commands_queries

    commands_queries.records(db, rig, _form(json=json, csv=csv))


@app.command()
def verdicts(db: Database, rig: Rig = None, json: Json = False, csv: Csv = False) -> None:
    """List what is believed of a rig's constants: a mass, a sensor's gain, a delay that is not as configured."""
    from agent.cli import queries as commands_queries

    commands_queries.verdicts(db, rig, _form(json=json, csv=csv))


@app.command()
def trend(  # noqa: PLR0913, PLR0917 the signature is the command line
    db: Annotated[Path, typer.Argument(metavar="DB|TABLE", help="Database, or CSV or Parquet.", show_default=False)],
    parameter: Annotated[
        str | None, typer.Argument(metavar="PARAMETER", help="For example k1; all without.", show_default=False)
    ] = None,
    rig: Rig = None,
    since: Since = None,
    until: Until = None,
    limit: Annotated[float | None, typer.Option(metavar="V", help="The value to cross, in its unit.")] = None,
    from_reference: Annotated[
        float | None, typer.Option("--from-reference", metavar="R", help="Take --limit as a change from R.")
    ] = None,
    like: Annotated[
        list[Path] | None, typer.Option(metavar="FILE", help="Like machines: DB, TABLE, or a prior of fleet learn.")
    ] = None,
    horizon: Annotated[str | None, typer.Option(metavar="T", help="How far ahead the chance is of: 90d, 12h.")] = None,
    json: Json = False,
    csv: Csv = False,
    plot: Plot = None,
) -> None:
    """Tell a parameter's drift, whether there is a trend, and when it reaches a limit."""
    from agent.cli.prognosis import trend as commands_trend

    ahead = commands_trend.Ahead(tuple(like or ()), horizon, from_reference)
    form = _form(json=json, csv=csv)
    commands_trend.trend(db, parameter, rig, (since, until), limit, form, plot, ahead)


@app.command()
def fleet(
    files: Annotated[
        list[Path], typer.Argument(metavar="[learn] DB|FOLDER|TABLE...", help="Databases, or folders of them.")
    ],
    within: Annotated[str, typer.Option(metavar="T", help="How far ahead the chance is of: 90d, 12h.")] = "90d",
    parameter: Annotated[str | None, typer.Option(metavar="P", help="Only this parameter.")] = None,
    limit_percent: Annotated[
        float, typer.Option("--limit-percent", metavar="X", help="The limit of a parameter that never raised an alarm.")
    ] = 20.0,
    to: Annotated[Path | None, typer.Option(metavar="PRIOR", help="With learn: the file to write.")] = None,
    limit: Annotated[float | None, typer.Option(metavar="V", help="With learn: where lives end.")] = None,
    json: Json = False,
) -> None:
    """Tell which parts of many machines change fastest and which reach a limit; learn: what like machines teach."""
    from agent.cli.prognosis import fleet as commands_fleet

    if str(files[0]) == "learn":
        document = commands_fleet.learn_prior(files[1:], parameter, limit, to)
        _answer(document, commands_fleet.print_learnt, as_json=json)
    else:
        document = commands_fleet.fleet(files, within, parameter, limit_percent)
        _answer(document, commands_fleet.print_fleet, as_json=json)


@app.command()
def export(
    db: Database,
    what: Annotated[
        str,
        typer.Argument(metavar="WHAT", help="estimates, alarms, alarm_events, health, runs, event_records, verdicts."),
    ] = "estimates",
    rig: Rig = None,
    to: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write to FILE (.csv or .parquet), not stdout.")
    ] = None,
) -> None:
    """Write a view of the database as CSV or Parquet."""
    from agent.cli import db as commands_db

    commands_db.export(db, what, rig, to)


database = typer.Typer(help="Look after a database file.", no_args_is_help=True, rich_markup_mode=None)
app.add_typer(database, name="db")


@database.command("check")
def db_check(db: Database, json: Json = False) -> None:
    """Read a whole file and say what is wrong with it; it may be in use."""
    from agent.cli import db as commands_db

    commands_db.check(db, as_json=json)


@database.command("repair")
def db_repair(db: Database, json: Json = False) -> None:
    """Replace a damaged file by one of every row that proves itself; the damaged one is kept beside it."""
    from agent.cli import db as commands_db

    commands_db.repair(db, as_json=json)


@database.command("compact")
def db_compact(db: Database, json: Json = False) -> None:
    """Give the file's free pages back to the disk."""
    from agent.cli import db as commands_db

    commands_db.compact(db, as_json=json)


@database.command("backup")
def db_backup(
    db: Database,
    target: Annotated[Path, typer.Argument(metavar="TARGET", help="The copy; must not exist.", show_default=False)],
    json: Json = False,
) -> None:
    """Copy a file, also while an agent writes to it."""
    from agent.cli import db as commands_db

    commands_db.backup(db, target, as_json=json)


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and leave with its exit code."""
    # two threads are ten times slower than one on the small products here; numpy reads this when it is first imported
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with done_when_terminated():
        from agent.cli.terminal.errors import guarded

        sys.exit(guarded(app, list(sys.argv[1:] if argv is None else argv)))


def _operate(
    db: Path,
    cause: "Cause",
    ids: list[int],
    why: tuple[str | None, str | None],
    length: str | None = None,
    *,
    json: bool,
) -> None:
    """Have alarms take a step and say what they did."""
    from agent.cli.operator import commands as body

    document = body.act(db, cause, ids, body.Why(*why), length)
    _answer(document, body.print_taken, as_json=json)


def _answer(document: Mapping[str, Any], table: Callable[[Mapping[str, Any]], None], *, as_json: bool) -> None:
    """Print a document as JSON or as a table."""
    from agent.cli.terminal.output import print_json

    if as_json:
        print_json(document)
    else:
        table(document)


def _named(db: Path | None) -> Path:
    """Return the database that was named. Raises UsageError for none."""
    from agent.errors import UsageError

    if db is None:
        raise UsageError.at("DB", "is missing", "name the database file of the agent")
    return db


def _form(*, json: bool, csv: bool) -> str:
    """Return which form of output was asked for. Raises UsageError for two."""
    from agent.errors import UsageError

    if json and csv:
        raise UsageError.at("--csv", "cannot go with --json", "ask for one of them")
    return "json" if json else "csv" if csv else "table"
