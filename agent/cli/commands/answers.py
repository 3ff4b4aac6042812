"""What the database answers: estimates, verdicts, trends, fleets, and files of them."""

from pathlib import Path
from typing import Annotated

import typer

from agent.cli.commands.options import Csv, Database, Json, Plot, Rig, Since, Until, answer, form_of

part = typer.Typer()


@part.command()
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
    from agent.cli.tables import queries as commands_queries

    commands_queries.estimates(db, rig, parameter, since, until, form_of(json=json, csv=csv))


@part.command()
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
    form = form_of(json=json, csv=csv)
    commands_trend.trend(db, parameter, rig, (since, until), limit, form, plot, ahead)


@part.command(
    help="Tell which parts of many machines change fastest and which reach a limit; "
    "learn: what like machines teach."
)
def fleet(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="[learn] DB|FOLDER|URL|TABLE...",
            help="Databases, tables, folders of them, Parquet archives, postgresql://USER@HOST/NAME#PREFIX.",
        ),
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

    if files[0] == "learn":
        document = commands_fleet.learn_prior([Path(file) for file in files[1:]], parameter, limit, to)
        answer(document, commands_fleet.print_learnt, as_json=json)
    else:
        document = commands_fleet.fleet(files, within, parameter, limit_percent)
        answer(document, commands_fleet.print_fleet, as_json=json)


@part.command(
    help="List what is believed of a rig's constants: "
    "a mass, a sensor's gain, a delay that is not as configured."
)
def verdicts(db: Database, rig: Rig = None, json: Json = False, csv: Csv = False) -> None:
    """List what is believed of a rig's constants."""
    from agent.cli.tables import queries as commands_queries

    commands_queries.verdicts(db, rig, form_of(json=json, csv=csv))


@part.command()
def records(db: Database, rig: Rig = None, json: Json = False, csv: Csv = False) -> None:
    """List the raw samples that were kept around alarms; deltak replay reads the files."""
    from agent.cli.tables import queries as commands_queries

    commands_queries.records(db, rig, form_of(json=json, csv=csv))


@part.command()
def export(
    db: Database,
    what: Annotated[
        str,
        typer.Argument(
            metavar="WHAT",
            help="estimates, alarms, alarm_events, health, runs, events, tiers, event_records, verdicts, "
            "baselines, forecast, trend, covariates.",
        ),
    ] = "estimates",
    rig: Rig = None,
    to: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write to FILE (.csv or .parquet), not stdout.")
    ] = None,
) -> None:
    """Write a view of the database as CSV or Parquet."""
    from agent.cli.tables import db as commands_db

    commands_db.export(db, what, rig, to)
