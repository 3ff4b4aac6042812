"""From an unknown machine to limits that rest on its own healthy behaviour."""

from pathlib import Path
from typing import Annotated

import typer

from agent.cli.commands.options import Config, Json, Place, Plot, Rig, Since, Until, answer

part = typer.Typer()


@part.command()
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
    from agent.cli.commissioning import identify as commands_identify
    from agent.cli.terminal.errors import report_errors
    from agent.commissioning.identification import identify as body

    if graph:
        from agent.commissioning.graphs import choose

        document, seen = choose.choose(config=config, recordings=recordings or [], probe_s=probe, write=write)
    else:
        document, seen = body.identify(config=config, recordings=recordings or [], probe_s=probe, write=write)
    if plot is not None:
        commands_identify.draw(document, seen, plot)
    answer(document, commands_identify.print_identified, as_json=json)
    if not document["ok"]:
        raise typer.Exit(report_errors(document))


@part.command(
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
    from agent.cli.commissioning import compare as commands_compare
    from agent.evaluation.compare import compare as body

    document, rows = body.compare(config=config, recording=recording, methods=methods)
    if plot is not None:
        commands_compare.draw(document, rows, plot)
    answer(document, commands_compare.print_compared, as_json=json)


@part.command()
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
    answer(document, commands_excite.print_excitation, as_json=json)


baseline = typer.Typer(
    help="What parameters are like on a healthy machine: learn, show, exchange.", no_args_is_help=True,
    rich_markup_mode=None,
)  # fmt: skip


part.add_typer(baseline, name="baseline")


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
    answer(document, commands_baseline.print_learnt, as_json=json)


@baseline.command("show")
def baseline_show(place: Place, rig: Rig = None, json: Json = False) -> None:
    """Show the baselines that rows count from."""
    from agent.cli.commissioning import baseline as commands_baseline

    answer(commands_baseline.standing(place, rig), commands_baseline.print_baselines, as_json=json)


@baseline.command("list")
def baseline_list(place: Place, rig: Rig = None, json: Json = False) -> None:
    """List all baselines, also those that were learnt anew since."""
    from agent.cli.commissioning import baseline as commands_baseline

    answer(commands_baseline.every(place, rig), commands_baseline.print_baselines, as_json=json)


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

    answer(imported(place, rig, file), commands_baseline.print_imported, as_json=json)


@part.command()
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
        answer(document, commands_limits.print_tried, as_json=json)
    else:
        document = commands_limits.proposed(place, rig, per_year, config, write=write)
        answer(document, commands_limits.print_limits, as_json=json)


@part.command()
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
    from agent.cli.commissioning import score as commands_score
    from agent.evaluation.score.score import score as body

    document = body(scenarios or [], fault or [], commands_score.progress())
    answer(document, commands_score.print_score, as_json=json)
    if not document["ok"]:
        raise typer.Exit(commands_score.NOT_MET)
