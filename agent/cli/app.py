"""The command line. Each command imports what it needs when it runs, so that `deltak --help` answers at once.

Command bodies return the documents of the JSON interface as plain dicts and print nothing; this module prints
them, turns errors into lines and exit codes, and knows no more.
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
from agent.cli.terminal.start import fast_import

if TYPE_CHECKING:
    from agent.alarms.life_cycle import Cause

app = typer.Typer(
    name="deltak",
    cls=CommandGroup,
    help="Estimate stiffness and damping of a structure over its field bus, and alarm when they leave "
    "their limits.",
    epilog="Exit codes: 0 done, 1 unforeseen, 2 usage or configuration, 3 database, 4 bus, 130 interrupted.",
    add_completion=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)


class Bus(StrEnum):
    """The buses that the demo can play."""

    MODBUS = "modbus"
    CAN = "can"
    SERIAL = "serial"


class DemoRig(StrEnum):
    """The rigs of the demo."""

    MASSES = "two-mass"
    COIL = "voice-coil"


class RunKind(StrEnum):
    """What a live run is marked as; the demo's parent process marks its own."""

    LIVE = "live"
    DEMO = "demo"


Json = Annotated[bool, typer.Option("--json", help="One JSON document on stdout and nothing else.")]
Csv = Annotated[bool, typer.Option("--csv", help="CSV on stdout, every digit, empty for none.")]
Config = Annotated[
    Path, typer.Argument(metavar="CONFIG", help="Configuration file (TOML).", show_default=False)
]
Database = Annotated[
    Path, typer.Argument(metavar="DB", help="Database file of the agent.", show_default=False)
]
Agent = Annotated[
    Path | None,
    typer.Argument(
        metavar="[CONFIG|DB]", help="Whose agent; without it the only one there is.", show_default=False
    ),
]
NewDb = Annotated[
    Path | None, typer.Option("--db", metavar="FILE", help="Database to write; created if missing.")
]
Rig = Annotated[str | None, typer.Option("--rig", help="Only this rig.")]
Since = Annotated[
    str | None,
    typer.Option("--since", metavar="T", help="ISO 8601, or an age back from the newest row: 90s, 12h, 30d"),
]
Until = Annotated[
    str | None, typer.Option("--until", metavar="T", help="As --since; both ends belong to the answer.")
]
Plot = Annotated[
    Path | None, typer.Option("--plot", metavar="FILE", help="Draw to FILE (.png, .svg or .pdf).")
]
Duration = Annotated[
    float | None, typer.Option("--duration", metavar="S", min=0.0, help="Stop after S seconds.")
]


@app.callback(invoke_without_command=True)
def _start(
    ctx: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
    _verbose: Annotated[
        int,
        typer.Option("-v", "--verbose", count=True, show_default=False, help="Log progress; -vv logs all."),
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
    rig: Annotated[
        DemoRig, typer.Option(help="Two masses, or a voice coil: voltage in, position out.")
    ] = DemoRig.MASSES,
    scenario: Annotated[
        str | None, typer.Option(metavar="NAME", help="A scenario that ships with deltak.")
    ] = None,
    fast: Annotated[
        bool, typer.Option("--fast", help="As fast as no sample is lost, not in real time.")
    ] = False,
    db: NewDb = None,
    json: Json = False,
) -> None:
    """Run a simulated rig and the agent end to end, and hold the estimates against the truth."""
    from agent.cli import results as commands_results
    from agent.evaluation.demo import demo as body

    document = body.demo(bus=bus.value, scenario=scenario, fast=fast, db=db, rig=rig.value)
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
        Path | None,
        typer.Option(metavar="FILE", help="Judge by this recording: each channel, and the sd to expect."),
    ] = None,
    probe: Annotated[
        bool, typer.Option("--probe", help="Listen to the sources for 5 s and judge by that.")
    ] = False,
    plot: Plot = None,
    db: Annotated[
        Path | None,
        typer.Option("--db", metavar="FILE", help="With --plot: show the newest estimates of a database."),
    ] = None,
    json: Json = False,
) -> None:
    """Check a configuration: faults, observability, poles, the sd to expect, advice."""
    from agent.cli import check as commands_check
    from agent.commissioning import check as body

    document = body.check(config=config, recording=recording, probe=probe)
    if plot is not None and document.get("observer"):
        from agent.commissioning.regions.picture import draw_region

        draw_region(config, document, plot, db)
    _answer(document, commands_check.print_check, as_json=json)
    if not document.get("ok", True):
        raise typer.Exit(commands_check.report_faults(document))


@app.command()
def run(
    configs: Annotated[
        list[Path], typer.Argument(metavar="CONFIG", help="Configuration files (TOML), or folders.")
    ],
    db: NewDb = None,
    duration: Duration = None,
    json: Json = False,
    kind: Annotated[RunKind, typer.Option(hidden=True, help="What the run is marked as.")] = RunKind.LIVE,
) -> None:
    """Run the agent in the foreground until SIGTERM, SIGINT or the end of --duration."""
    with fast_import():
        from agent.cli import results as commands_results
        from agent.runtime.workers import running

    document = running.run(configs=configs, db=db, duration_s=duration, kind=kind.value)
    _answer(document, commands_results.print_results, as_json=json)


@app.command()
def status(agent: Agent = None, json: Json = False) -> None:
    """Tell how a running agent is: rigs, sources, alarms, databases, threads."""
    from agent.cli.gateway import status as commands_status

    _answer(commands_status.status(agent), commands_status.print_status, as_json=json)


@app.command()
def reload(agent: Agent = None, json: Json = False) -> None:
    """Have a running agent take up changed configurations; rigs whose files did not change lose no sample."""
    from agent.cli.gateway import status as commands_status

    _answer(commands_status.reload(agent), commands_status.print_reload, as_json=json)


@app.command(
    help="Bundle what support needs: configuration without secrets, log, ledgers, "
    "versions, status, raw samples."
)
def diag(
    agent: Agent = None,
    to: Annotated[Path, typer.Option(metavar="FILE.tar.gz", help="The bundle to write.")] = Path(
        "deltak-diag.tar.gz"
    ),
    json: Json = False,
) -> None:
    """Bundle what support needs."""
    from agent.cli.gateway import diag as commands_diag

    _answer(commands_diag.diag(agent, to), commands_diag.print_diag, as_json=json)


@app.command()
def replay(
    config: Config,
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING", help="CSV, NPZ, CAN logs, own recordings.")
    ],
    db: NewDb = None,
    json: Json = False,
) -> None:
    """Run recordings through the same pipeline as the live agent, as fast as it goes."""
    with fast_import():
        from agent.cli import results as commands_results
        from agent.runtime import replay as body

    document = body.replay(config=config, recordings=recordings, db=db)
    _answer(document, commands_results.print_results, as_json=json)


@app.command()
def listen(config: Config, duration: Duration = None, json: Json = False) -> None:
    """Show what comes over the bus beside what it decodes to, until Ctrl-C or --duration; never transmits."""
    from agent.cli.setup import listen as commands_listen
    from agent.commissioning.setup import listen as body

    document = body.listen(config, duration, commands_listen.silent if json else commands_listen.print_line)
    _answer(document, commands_listen.print_summary, as_json=json)
    if document["interrupted"]:
        raise typer.Exit(commands_listen.INTERRUPTED)


@app.command()
def identify(
    config: Config,
    recordings: Annotated[
        list[Path] | None, typer.Argument(metavar="RECORDING", help="CSV, NPZ, CAN logs, own recordings.")
    ] = None,
    probe: Annotated[
        float | None,
        typer.Option("--probe", metavar="S", min=0.0, help="Listen to the sources for S seconds."),
    ] = None,
    write: Annotated[
        bool, typer.Option("--write", help="Put the values found into CONFIG; comments stay.")
    ] = False,
    graph: Annotated[
        bool, typer.Option("--graph", help="Choose first which springs and dampers there are at all.")
    ] = False,
    json: Json = False,
    plot: Plot = None,
) -> None:
    """Find springs and dampers from recordings, no nominal needed; of linear models from their nominals."""
    from agent.cli import identify as commands_identify
    from agent.commissioning import identify as body

    if graph:
        from agent.commissioning.graphs import choose

        document, seen = choose.choose(config=config, recordings=recordings or [], probe_s=probe, write=write)
    else:
        document, seen = body.identify(config=config, recordings=recordings or [], probe_s=probe, write=write)
    if plot is not None:
        commands_identify.draw(document, seen, plot)
    _answer(document, commands_identify.print_identified, as_json=json)
    if not document["ok"]:
        raise typer.Exit(commands_identify.report_refusal(document))


@app.command(
    help="Hold window-ml against other methods on a recording: "
    "estimates, prediction of what was not seen, cost."
)
def compare(
    config: Config,
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="CSV, NPZ, CAN logs, own recordings.")
    ],
    methods: Annotated[
        str | None,
        typer.Option(metavar="A,B,...", help="Of window-ml, ekf, ukf, rls, observer, seed; all without."),
    ] = None,
    json: Json = False,
    plot: Plot = None,
) -> None:
    """Hold window-ml against other methods on a recording."""
    from agent.cli import compare as commands_compare
    from agent.evaluation.compare import compare as body

    document, rows = body.compare(config=config, recording=recording, methods=methods)
    if plot is not None:
        commands_compare.draw(document, rows, plot)
    _answer(document, commands_compare.print_compared, as_json=json)


@app.command()
def init(  # noqa: PLR0913, PLR0917 the signature is the command line
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The file to write; must not exist.")],
    bus: Annotated[Bus | None, typer.Option(help="The bus; without one, for recordings.")] = None,
    name: Annotated[str | None, typer.Option(help="Name of the rig; the file's without.")] = None,
    rate: Annotated[float | None, typer.Option(metavar="HZ", help="Samples a second.")] = None,
    mass: Annotated[list[str] | None, typer.Option(metavar="NAME=KG", help="A mass; again for each.")] = None,
    spring: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=NODE,NODE[:NOMINAL]", help="A spring; none: no spring; left out: a chain."
        ),
    ] = None,
    damper: Annotated[
        list[str] | None, typer.Option(metavar="NAME=NODE,NODE[:NOMINAL]", help="A damper, as --spring.")
    ] = None,
    friction: Annotated[
        list[str] | None, typer.Option(metavar="NAME=NODE,NODE[:NOMINAL]", help="Dry friction, N.")
    ] = None,
    channel: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[NAME=]QUANTITY@MASS[:UNIT[:FIELD]]", help="A signal, e.g. x1=displacement@m1:mm."
        ),
    ] = None,
    kind: Annotated[
        str | None, typer.Option(metavar="KIND", help="Another model: dc-motor, thermal, linear ...")
    ] = None,
    element: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE|KEY:NAME=[A,B:]VALUE", help="Of --kind, e.g. R=4.8, tank:T1=0.05; or TOML."
        ),
    ] = None,
    counter: Annotated[
        str | None, typer.Option(metavar="FIELD", help="The field that counts the samples.")
    ] = None,
    interface: Annotated[
        str | None, typer.Option(help="CAN: as python-can names it; socketcan without.")
    ] = None,
    bus_channel: Annotated[str | None, typer.Option(metavar="NAME", help="CAN: such as can0.")] = None,
    dbc: Annotated[
        str | None, typer.Option(metavar="FILE", help="CAN: the DBC file, from FILE's folder.")
    ] = None,
    host: Annotated[str | None, typer.Option(help="Modbus TCP, socketcand: where the device is.")] = None,
    port: Annotated[str | None, typer.Option(help="TCP port, or the device of a serial line.")] = None,
    baudrate: Annotated[int | None, typer.Option(metavar="N", help="Serial, Modbus RTU.")] = None,
    columns: Annotated[
        str | None, typer.Option(metavar="A,B,...", help="Serial: the cells of a line of text.")
    ] = None,
    sync: Annotated[
        str | None, typer.Option(metavar="HEX", help="Serial: how a binary frame begins.")
    ] = None,
    fields: Annotated[
        str | None,
        typer.Option(
            metavar="NAME[@ADDRESS]:TYPE[:SCALE],...", help="Serial, Modbus: what follows one another."
        ),
    ] = None,
    crc: Annotated[str | None, typer.Option(metavar="NAME", help="Serial: such as CRC-16/IBM-3740.")] = None,
    device_id: Annotated[
        int | None, typer.Option("--device-id", metavar="N", help="Modbus: the unit.")
    ] = None,
    index: Annotated[
        str | None, typer.Option(metavar="ADDRESS[:TYPE]", help="Modbus: samples written so far.")
    ] = None,
    ring: Annotated[
        str | None, typer.Option(metavar="ADDRESS:SLOTS", help="Modbus: where the samples lie.")
    ] = None,
    json: Json = False,
) -> None:
    """Write a first configuration: asks on a terminal for what the flags leave open."""
    from agent.cli.setup import init as commands_init
    from agent.commissioning.setup import init as body
    from agent.commissioning.setup import plan

    keys = {
        "interface": interface, "channel": bus_channel, "dbc": dbc, "host": host, "port": port,
        "baudrate": baudrate,
        "columns": columns, "sync": sync, "fields": fields, "crc": crc, "device_id": device_id,
        "index": index,
        "ring": ring,
    }  # fmt: skip
    elements = {"spring": spring, "damper": damper, "friction": friction}
    stated = plan.stated(bus and bus.value, name, rate, (mass or [], channel or []), elements, counter, keys,
                          (kind, element or []))  # fmt: skip
    document = body.init(file, stated, commands_init.asking())
    _answer(document, commands_init.print_written, as_json=json)


@app.command()
def score(
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(metavar="SCENARIO...", help="Scenarios that name their rig; all that ship."),
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
    active: Annotated[
        bool, typer.Option("--active", help="Only those whose condition still stands.")
    ] = False,
    stats: Annotated[
        bool, typer.Option("--stats", help="Rates, floods, chattering: the standard's measures.")
    ] = False,
    since: Since = None,
    states: Annotated[
        bool, typer.Option("--states", help="The table of states and causes; needs no DB.")
    ] = False,
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


Ids = Annotated[
    list[int], typer.Argument(metavar="ID...", help="Numbers of alarms, as deltak alarms lists them.")
]
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
    ids: Annotated[
        list[int], typer.Argument(metavar="ID...", help="Numbers that deltak notify list --dead shows.")
    ],
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
    alarm: Annotated[
        int, typer.Argument(metavar="ID", help="Number of an alarm, as deltak alarms lists it.")
    ],
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


@app.command(
    help="List what is believed of a rig's constants: "
    "a mass, a sensor's gain, a delay that is not as configured."
)
def verdicts(db: Database, rig: Rig = None, json: Json = False, csv: Csv = False) -> None:
    """List what is believed of a rig's constants."""
    from agent.cli import queries as commands_queries

    commands_queries.verdicts(db, rig, _form(json=json, csv=csv))


@app.command()
def trend(  # noqa: PLR0913, PLR0917 the signature is the command line
    db: Annotated[
        Path, typer.Argument(metavar="DB|TABLE", help="Database, or CSV or Parquet.", show_default=False)
    ],
    parameter: Annotated[
        str | None,
        typer.Argument(metavar="PARAMETER", help="For example k1; all without.", show_default=False),
    ] = None,
    rig: Rig = None,
    since: Since = None,
    until: Until = None,
    limit: Annotated[float | None, typer.Option(metavar="V", help="The value to cross, in its unit.")] = None,
    from_reference: Annotated[
        float | None, typer.Option("--from-reference", metavar="R", help="Take --limit as a change from R.")
    ] = None,
    like: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Like machines: DB, TABLE, or a prior of fleet learn."),
    ] = None,
    horizon: Annotated[
        str | None, typer.Option(metavar="T", help="How far ahead the chance is of: 90d, 12h.")
    ] = None,
    json: Json = False,
    csv: Csv = False,
    plot: Plot = None,
) -> None:
    """Tell a parameter's drift, whether there is a trend, and when it reaches a limit."""
    from agent.cli.prognosis import trend as commands_trend

    ahead = commands_trend.Ahead(tuple(like or ()), horizon, from_reference)
    form = _form(json=json, csv=csv)
    commands_trend.trend(db, parameter, rig, (since, until), limit, form, plot, ahead)


@app.command(
    help="Tell which parts of many machines change fastest and which reach a limit; "
    "learn: what like machines teach."
)
def fleet(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="[learn] DB|FOLDER|TABLE...", help="Databases, or folders of them."),
    ],
    within: Annotated[
        str, typer.Option(metavar="T", help="How far ahead the chance is of: 90d, 12h.")
    ] = "90d",
    parameter: Annotated[str | None, typer.Option(metavar="P", help="Only this parameter.")] = None,
    limit_percent: Annotated[
        float,
        typer.Option(
            "--limit-percent", metavar="X", help="The limit of a parameter that never raised an alarm."
        ),
    ] = 20.0,
    to: Annotated[Path | None, typer.Option(metavar="PRIOR", help="With learn: the file to write.")] = None,
    limit: Annotated[float | None, typer.Option(metavar="V", help="With learn: where lives end.")] = None,
    json: Json = False,
) -> None:
    """Tell which parts of many machines change fastest and which reach a limit."""
    from agent.cli.prognosis import fleet as commands_fleet

    if str(files[0]) == "learn":
        document = commands_fleet.learn_prior(files[1:], parameter, limit, to)
        _answer(document, commands_fleet.print_learnt, as_json=json)
    else:
        document = commands_fleet.fleet(files, within, parameter, limit_percent)
        _answer(document, commands_fleet.print_fleet, as_json=json)


@app.command()
def watch(
    target: Annotated[
        Path | None,
        typer.Argument(metavar="[CONFIG|DB]", help="The only *.db here without.", show_default=False),
    ] = None,
    once: Annotated[bool, typer.Option("--once", help="One frame, for scripts and pipes.")] = False,
) -> None:
    """Show at a glance, in the terminal: values against their limits, states, alarms, sources; q quits."""
    from agent.cli.glance import watch as commands_watch

    commands_watch.watch(target, once=once)


@app.command()
def serve(  # noqa: PLR0913, PLR0917 the signature is the command line
    db: Annotated[
        list[Path] | None, typer.Option("--db", metavar="DB", help="Database to show; may be repeated.")
    ] = None,
    config: Annotated[
        list[Path] | None,
        typer.Option("--config", metavar="CONFIG", help="Shows its database, limits and model."),
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 for a free one.")] = 8765,
    password_file: Annotated[
        Path | None,
        typer.Option("--password-file", metavar="FILE", help="Hash of the password for acknowledging."),
    ] = None,
    token_file: Annotated[
        Path | None, typer.Option("--token-file", metavar="FILE", help="A token instead of a password.")
    ] = None,
    private: Annotated[bool, typer.Option("--private", help="Reading needs the password too.")] = False,
    hostname: Annotated[
        list[str] | None, typer.Option("--hostname", metavar="NAME", help="A name that the server goes by.")
    ] = None,
    proxy: Annotated[
        str | None,
        typer.Option("--proxy", metavar="ADDRESS", help="The reverse proxy whose headers are believed."),
    ] = None,
    new_password: Annotated[
        Path | None,
        typer.Option("--new-password", metavar="FILE", help="Ask for a password, write its hash, stop."),
    ] = None,
) -> None:
    """Show the page and answer the HTTP API; a process of its own that only reads the databases."""
    from agent.cli.web import serve as commands_serve

    if new_password is not None:
        commands_serve.new_password(new_password)
        return
    options = commands_serve.Options(host, port, password_file, token_file, private, hostname or (), proxy)
    commands_serve.serve(db or [], config or [], options)


@app.command()
def opcua(  # noqa: PLR0913, PLR0917 the signature is the command line
    target: Annotated[
        list[Path] | None,
        typer.Argument(metavar="DB|CONFIG...", help="What to serve; a configuration its database."),
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 for a free one.")] = 4840,
    hostname: Annotated[
        str | None, typer.Option("--hostname", metavar="NAME", help="The name under which clients reach it.")
    ] = None,
    users: Annotated[
        Path | None,
        typer.Option("--users", metavar="FILE", help="Users that may act, with hashes of passwords."),
    ] = None,
    new_user: Annotated[
        str | None,
        typer.Option("--new-user", metavar="NAME", help="Ask for a password, add it to --users, stop."),
    ] = None,
    certificate: Annotated[
        Path | None,
        typer.Option("--certificate", metavar="FILE", help="The server's certificate, PEM or DER."),
    ] = None,
    key: Annotated[Path | None, typer.Option("--key", metavar="FILE", help="Its private key.")] = None,
    trusted: Annotated[
        Path | None,
        typer.Option("--trusted", metavar="FOLDER", help="Certificates of clients; others are refused."),
    ] = None,
    private: Annotated[bool, typer.Option("--private", help="Reading needs a user too.")] = False,
) -> None:
    """Serve parameters and alarms over OPC UA; a process of its own that only reads the databases."""
    from agent.cli.opcua import serve as commands_opcua

    if new_user is not None:
        commands_opcua.add_user(users, new_user)
        return
    options = commands_opcua.Options(host, port, hostname, users, certificate, key, trusted, private)
    commands_opcua.serve(target or [], options)


@app.command()
def upgrade(
    places: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[CONFIG|DB]...", help="Without it what the services run on.", show_default=False
        ),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Say what this version would do; change nothing.")
    ] = False,
    to: Annotated[
        str | None, typer.Option("--to", metavar="VERSION", help="Have an installed version run.")
    ] = None,
    within: Annotated[
        float, typer.Option(metavar="S", min=0.0, help="With --to: back after S seconds without valid rows.")
    ] = 180.0,
    stop: Annotated[
        str | None, typer.Option(metavar="COMMAND", help="Ends the agents; else systemd does.")
    ] = None,
    start: Annotated[
        str | None, typer.Option(metavar="COMMAND", help="Starts them; else systemd does.")
    ] = None,
    home: Annotated[Path, typer.Option(metavar="DIR", help="Where versions lie side by side.")] = Path(
        "/opt/deltak"
    ),
    json: Json = False,
) -> None:
    """Check what this version would do to databases and configurations, or have another version take over."""
    from agent.cli.upgrade import command as commands_upgrade

    if to is None:
        code = commands_upgrade.checked(places or (), asked=check, as_json=json)
        raise typer.Exit(code)
    options = commands_upgrade.Options(home, to, within, stop, start)
    commands_upgrade.switched(places or (), options, asked=check, as_json=json)


@app.command()
def export(
    db: Database,
    what: Annotated[
        str,
        typer.Argument(
            metavar="WHAT",
            help="estimates, alarms, alarm_events, health, runs, event_records, verdicts, baselines, "
            "forecast, covariates.",
        ),
    ] = "estimates",
    rig: Rig = None,
    to: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write to FILE (.csv or .parquet), not stdout.")
    ] = None,
) -> None:
    """Write a view of the database as CSV or Parquet."""
    from agent.cli import db as commands_db

    commands_db.export(db, what, rig, to)


Place = Annotated[
    Path,
    typer.Argument(
        metavar="DB|CONFIG", help="Database, or the configuration that names it.", show_default=False
    ),
]
baseline = typer.Typer(
    help="What parameters are like on a healthy machine: learn, show, exchange.", no_args_is_help=True,
    rich_markup_mode=None,
)  # fmt: skip
app.add_typer(baseline, name="baseline")


@baseline.command(
    "learn",
    help="Learn references and their spread from the valid rows of a healthy stretch; "
    "rows count from them at once.",
)
def baseline_learn(
    place: Place,
    rig: Rig = None,
    parameter: Annotated[
        list[str] | None, typer.Option(metavar="P", help="Only this parameter; may be given again.")
    ] = None,
    since: Since = None,
    until: Until = None,
    hours: Annotated[
        float | None, typer.Option(metavar="H", help="Hours with valid rows that are wanted at least [24].")
    ] = None,
    json: Json = False,
) -> None:
    """Learn references and their spread from the valid rows of a healthy stretch."""
    from agent.cli.commissioning import baseline as commands_baseline
    from agent.commissioning.baseline import learn as body
    from agent.commissioning.progress import on_terminal

    stretch = body.Stretch(tuple(parameter or ()), since, until, hours)
    document = body.learn(place, rig, stretch, on_terminal())
    _answer(document, commands_baseline.print_learnt, as_json=json)


@baseline.command("show")
def baseline_show(place: Place, rig: Rig = None, json: Json = False) -> None:
    """Show the baselines that rows count from."""
    from agent.cli.commissioning import baseline as commands_baseline

    _answer(commands_baseline.standing(place, rig), commands_baseline.print_baselines, as_json=json)


@baseline.command("list")
def baseline_list(place: Place, rig: Rig = None, json: Json = False) -> None:
    """List all baselines, also those that were learnt anew since."""
    from agent.cli.commissioning import baseline as commands_baseline

    _answer(commands_baseline.every(place, rig), commands_baseline.print_baselines, as_json=json)


@baseline.command("export")
def baseline_export(
    place: Place,
    rig: Rig = None,
    to: Annotated[Path | None, typer.Option(metavar="FILE", help="Write to FILE, not stdout.")] = None,
) -> None:
    """Write the baselines that rows count from as JSON."""
    from agent.cli.commissioning import baseline as commands_baseline
    from agent.commissioning.baseline.exchange import exported

    commands_baseline.write_export(exported(place, rig), to)


@baseline.command("import")
def baseline_import(
    place: Place,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="What export wrote.", show_default=False)],
    rig: Rig = None,
    json: Json = False,
) -> None:
    """Count from the baselines of a file; refused where they are of another graph, parameter or unit."""
    from agent.cli.commissioning import baseline as commands_baseline
    from agent.commissioning.baseline.exchange import imported

    _answer(imported(place, rig, file), commands_baseline.print_imported, as_json=json)


@app.command()
def limits(  # noqa: PLR0913, PLR0917 the signature is the command line
    place: Place,
    rig: Rig = None,
    per_year: Annotated[
        float,
        typer.Option("--per-year", metavar="N", help="False alarms a year at the most, each parameter."),
    ] = 1.0,
    write: Annotated[
        bool, typer.Option("--write", help="Put limits and delays into CONFIG; all else stays.")
    ] = False,
    config: Annotated[
        Path | None,
        typer.Option("--config", metavar="CONFIG", help="With --write and a DB: the file to write to."),
    ] = None,
    trial: Annotated[
        Path | None,
        typer.Option("--try", metavar="FILE", help="Decide the stored history under FILE's limits."),
    ] = None,
    since: Since = None,
    until: Until = None,
    json: Json = False,
) -> None:
    """Propose limits and delays that a healthy machine seldom crosses, from its baseline; or try others."""
    from agent.cli.commissioning import limits as commands_limits

    if trial is not None:
        document = commands_limits.tried(place, rig, trial, (since, until), write=write)
        _answer(document, commands_limits.print_tried, as_json=json)
    else:
        document = commands_limits.proposed(place, rig, per_year, config, write=write)
        _answer(document, commands_limits.print_limits, as_json=json)


@app.command()
def excite(
    config: Config,
    seconds: Annotated[float, typer.Option(metavar="S", help="How long the motion may be.")],
    to: Annotated[
        Path, typer.Option(metavar="FILE.csv", help="The file for the operator's own shaker or drive.")
    ],
    recording: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The recording at hand, to compare with.")
    ] = None,
    max_force: Annotated[
        float | None,
        typer.Option("--max-force", metavar="F", help="Greatest force, in the force channel's unit."),
    ] = None,
    max_stroke: Annotated[
        float | None,
        typer.Option("--max-stroke", metavar="X", help="Greatest displacement, in its channel's unit."),
    ] = None,
    band: Annotated[
        tuple[float, float] | None, typer.Option(metavar="LO HI", help="Frequencies that are allowed, Hz.")
    ] = None,
    json: Json = False,
) -> None:
    """Design the motion that teaches most within force, stroke and band; deltak itself never transmits."""
    from agent.cli.commissioning import excite as commands_excite
    from agent.commissioning.excitation import excite as body

    bounds = body.Bounds(seconds, max_force, max_stroke, band)
    document = body.excite(config=config, recording=recording, bounds=bounds, to=to)
    _answer(document, commands_excite.print_excitation, as_json=json)


examples = typer.Typer(help="Configurations that come along.", no_args_is_help=True, rich_markup_mode=None)
app.add_typer(examples, name="examples")


@examples.command("list")
def examples_list(json: Json = False) -> None:
    """Name the examples, each with what it is."""
    from agent.cli.setup import examples as commands_examples
    from agent.commissioning.setup import examples as body

    _answer(body.listed(), commands_examples.print_examples, as_json=json)


@examples.command("copy")
def examples_copy(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="As examples list shows it.", show_default=False)
    ],
    folder: Annotated[Path, typer.Argument(metavar="[DIR]", help="Where to; made if missing.")] = Path(),
    json: Json = False,
) -> None:
    """Copy an example and the files that it needs; nothing is overwritten."""
    from agent.cli.setup import examples as commands_examples
    from agent.commissioning.setup import examples as body

    _answer(body.copied(name, folder), commands_examples.print_copied, as_json=json)


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
    target: Annotated[
        Path, typer.Argument(metavar="TARGET", help="The copy; must not exist.", show_default=False)
    ],
    json: Json = False,
) -> None:
    """Copy a file, also while an agent writes to it."""
    from agent.cli import db as commands_db

    commands_db.backup(db, target, as_json=json)


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and leave with its exit code."""
    # two threads are ten times slower than one on the small products here; numpy reads this at its import
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


def _answer(
    document: Mapping[str, Any], table: Callable[[Mapping[str, Any]], None], *, as_json: bool
) -> None:
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
