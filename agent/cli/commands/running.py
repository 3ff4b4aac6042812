"""The agent itself: run, replay, look after, upgrade."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from agent.cli.commands.options import Agent, Config, Duration, Json, NewDb, answer
from agent.cli.terminal.start import fast_import


class RunKind(StrEnum):
    """What a live run is marked as; the demo's parent process marks its own."""

    LIVE = "live"
    DEMO = "demo"


part = typer.Typer()


@part.command()
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
        from agent.cli.tables import results as commands_results
        from agent.runtime.workers import running

    document = running.run(configs=configs, db=db, duration_s=duration, kind=kind.value)
    answer(document, commands_results.print_results, as_json=json)


@part.command()
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
        from agent.cli.tables import results as commands_results
        from agent.runtime import replay as body

    document = body.replay(config=config, recordings=recordings, db=db)
    answer(document, commands_results.print_results, as_json=json)


@part.command()
def reestimate(
    archives: Annotated[
        list[Path], typer.Argument(metavar="ARCHIVE...", help="Recordings, or folders of them.")
    ],
    config: Annotated[
        list[Path],
        typer.Option("--config", metavar="NEW", help="For the rig of its name; the only one is for all."),
    ],
    scheduler: Annotated[
        str,
        typer.Option(metavar="local|ADDRESS", help="Processes here, or a Dask scheduler's dask://HOST:PORT."),
    ] = "local",
    workers: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Processes here; one a core without it.")
    ] = None,
    db: Annotated[
        str | None,
        typer.Option("--db", metavar="FILE|FOLDER/", help="One database for all rigs, or one each."),
    ] = None,
    json: Json = False,
) -> None:
    """Estimate archives of raw recordings again under another model, window or version, rigs side by side."""
    from agent.cli.tables import reestimate as commands_reestimate
    from agent.runtime.reestimation.reestimate import Wanted

    document = commands_reestimate.reestimate(Wanted(archives, config, db, scheduler, workers))
    answer(document, commands_reestimate.print_reestimated, as_json=json)
    if document["errors"]:
        raise typer.Exit(2)


@part.command()
def status(agent: Agent = None, json: Json = False) -> None:
    """Tell how a running agent is: rigs, sources, alarms, databases, threads."""
    from agent.cli.gateway import status as commands_status

    answer(commands_status.status(agent), commands_status.print_status, as_json=json)


@part.command()
def reload(agent: Agent = None, json: Json = False) -> None:
    """Have a running agent take up changed configurations; rigs whose files did not change lose no sample."""
    from agent.cli.gateway import status as commands_status

    answer(commands_status.reload(agent), commands_status.print_reload, as_json=json)


@part.command(
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

    answer(commands_diag.diag(agent, to), commands_diag.print_diag, as_json=json)


@part.command()
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
