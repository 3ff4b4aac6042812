"""Alarms: the list, what an operator does to them, why they came, who is notified."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from agent.cli.commands.options import Config, Csv, Database, Json, Plot, Rig, Since, answer, form_of, named

if TYPE_CHECKING:
    from agent.alarms.life_cycle import Cause

Ids = Annotated[
    list[int], typer.Argument(metavar="ID...", help="Numbers of alarms, as deltak alarms lists them.")
]


By = Annotated[str | None, typer.Option("--by", metavar="WHO", help="Who does it; the user by default.")]


Comment = Annotated[str | None, typer.Option("--comment", metavar="TEXT", help="Why.")]


part = typer.Typer()


@part.command()
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
    from agent.errors import UsageError

    form = form_of(json=json, csv=csv)
    if since is not None and not stats:
        raise UsageError.at("--since", "goes with --stats", "add --stats, or leave it out")
    if states:
        body.print_states(as_json=json)
    elif stats:
        answer(body.statistics(named(db), rig, since), body.print_statistics, as_json=json)
    else:
        body.alarms(named(db), rig, form, active=active)


@part.command()
def ack(db: Database, ids: Ids, by: By = None, comment: Comment = None, json: Json = False) -> None:
    """Acknowledge alarms: somebody knows of them."""
    _operate(db, "acknowledge", ids, (by, comment), json=json)


@part.command()
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


@part.command()
def unshelve(db: Database, ids: Ids, by: By = None, comment: Comment = None, json: Json = False) -> None:
    """End the shelf of alarms; one that stands is acknowledged by that."""
    _operate(db, "unshelve", ids, (by, comment), json=json)


@part.command()
def oos(db: Database, ids: Ids, by: By = None, comment: Comment = None, json: Json = False) -> None:
    """Take alarms out of service, until they are returned."""
    _operate(db, "out of service", ids, (by, comment), json=json)


@part.command("return")
def return_(db: Database, ids: Ids, by: By = None, comment: Comment = None, json: Json = False) -> None:
    """Return alarms to service; one that stands is to be acknowledged."""
    _operate(db, "return", ids, (by, comment), json=json)


@part.command()
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

    answer(body.explain(db, alarm, plot), body.print_explained, as_json=json)


notify = typer.Typer(help="Look after notifications of alarms.", no_args_is_help=True, rich_markup_mode=None)


part.add_typer(notify, name="notify")


@notify.command("list")
def notify_list(
    db: Database,
    dead: Annotated[bool, typer.Option("--dead", help="Only those that were given up.")] = False,
    json: Json = False,
    csv: Csv = False,
) -> None:
    """List what became of each notification."""
    from agent.cli.operator import notify as body

    body.listed(db, form_of(json=json, csv=csv), dead=dead)


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

    answer(body.resend(db, ids), body.print_resent, as_json=json)


@notify.command("test")
def notify_test(config: Config, json: Json = False) -> None:
    """Send a test message to each target of a configuration."""
    from agent.cli.operator import notify as body
    from agent.cli.terminal.errors import report_errors

    document = body.test(config)
    answer(document, body.print_tested, as_json=json)
    if not document["ok"]:
        raise typer.Exit(report_errors(document))


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
    answer(document, body.print_taken, as_json=json)
