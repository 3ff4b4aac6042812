"""The first steps on a machine: a configuration, what comes over the bus, what the model makes of it."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from agent.cli.commands.options import Config, Duration, Json, NewDb, Plot, answer


class Bus(StrEnum):
    """The buses that the demo can play."""

    MODBUS = "modbus"
    CAN = "can"
    SERIAL = "serial"


class DemoRig(StrEnum):
    """The rigs of the demo."""

    MASSES = "two-mass"
    COIL = "voice-coil"


part = typer.Typer()


@part.command()
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
    from agent.cli.tables import results as commands_results
    from agent.evaluation.demo import demo as body

    document = body.demo(bus=bus.value, scenario=scenario, fast=fast, db=db, rig=rig.value)
    answer(document, commands_results.print_demo, as_json=json)


@part.command()
def paper(
    window: Annotated[int | None, typer.Option(metavar="N", min=1, help="Samples in the window.")] = None,
    passes: Annotated[int | None, typer.Option(metavar="P", min=1, help="Passes of re-centring.")] = None,
    json: Json = False,
    plot: Plot = None,
) -> None:
    """Recompute the paper's tables 1 and 3 and its figures 3 and 4, and say what differs."""
    from agent.cli.terminal.output import show
    from agent.evaluation.paper import paper as body

    document = body.paper(window=window, passes=passes, plot=plot)
    answer(document, lambda found: show(body.table(found)), as_json=json)


@part.command()
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
    checksum: Annotated[
        str | None, typer.Option(metavar="nmea", help="Serial: of lines such as $IIXDR,1.5,2*HH.")
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
        "baudrate": baudrate, "columns": columns, "checksum": checksum, "sync": sync, "fields": fields,
        "crc": crc, "device_id": device_id, "index": index, "ring": ring,
    }  # fmt: skip
    elements = {"spring": spring, "damper": damper, "friction": friction}
    model = (kind, element or [])
    stated = plan.stated(
        bus and bus.value, name, rate, (mass or [], channel or []), elements, counter, keys, model
    )
    document = body.init(file, stated, commands_init.asking())
    answer(document, commands_init.print_written, as_json=json)


@part.command()
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
    from agent.cli.commissioning import check as commands_check
    from agent.cli.terminal.errors import report_errors
    from agent.commissioning import check as body

    document = body.check(config=config, recording=recording, probe=probe)
    if plot is not None and document.get("observer"):
        from agent.commissioning.regions.picture import draw_region

        draw_region(config, document, plot, db)
    answer(document, commands_check.print_check, as_json=json)
    if not document.get("ok", True):
        raise typer.Exit(report_errors(document))


@part.command()
def listen(config: Config, duration: Duration = None, json: Json = False) -> None:
    """Show what comes over the bus beside what it decodes to, until Ctrl-C or --duration; never transmits."""
    from agent.cli.setup import listen as commands_listen
    from agent.commissioning.setup import listen as body

    document = body.listen(config, duration, commands_listen.silent if json else commands_listen.print_line)
    answer(document, commands_listen.print_summary, as_json=json)
    if document["interrupted"]:
        raise typer.Exit(commands_listen.INTERRUPTED)


examples = typer.Typer(help="Configurations that come along.", no_args_is_help=True, rich_markup_mode=None)


part.add_typer(examples, name="examples")


@examples.command("list")
def examples_list(json: Json = False) -> None:
    """Name the examples, each with what it is."""
    from agent.cli.setup import examples as commands_examples
    from agent.commissioning.setup import examples as body

    answer(body.listed(), commands_examples.print_examples, as_json=json)


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

    answer(body.copied(name, folder), commands_examples.print_copied, as_json=json)
