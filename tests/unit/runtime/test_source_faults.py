"""What a driver cannot work with is said with the source's number and the key, by check, run and replay
alike."""

from collections.abc import Callable
from pathlib import Path

import pytest

from agent.commissioning.check import check
from agent.errors import ConfigError, Fault
from agent.runtime.replay import replay
from agent.runtime.workers.running import run
from tests.faults.played import RIG

TEXT = '[[source]]\ndriver = "serial"\nport = "x.tty"\nformat = "text"\ncolumns = ["F", "X"]\n'
POLL = (
    '[[source]]\ndriver = "modbus"\nmode = "poll"\nfields = [{ name = "F", type = "int32", address = 1 }, '
    '{ name = "X", type = "float32", address = 3 }]\n'
)
CAN = '[[source]]\ndriver = "can"\ninterface = "socketcand"\nchannel = "can0"\ndbc = "none.dbc"\n'
RING = (
    '[[source]]\ndriver = "modbus"\nmode = "ring"\nindex = { address = 0 }\n'
    "ring = { address = 60000, slots = 9000 }\n"
    'fields = [{ name = "F", type = "int16" }, { name = "X", type = "int16" }]\n'
)
MAP = 'map = { force = "F", x1 = "X" }\n'
CASES = [
    (
        '[[source]]\ndriver = "serial"\nport = "x"\nformat = "text"\n' + MAP,
        'source[0].format: format "text" needs',
    ),
    (
        TEXT.replace('"F"', '"$X", "F"') + 'checksum = "nmea"\n' + MAP,
        'source[0].columns: with checksum = "nmea" a line is $ADDRESS,cells*HH',
    ),
    (
        TEXT + 'map = { force = "G", x1 = "X" }',
        'source[0].map.force: no column is called "G"; columns are F, X',
    ),
    (POLL + MAP + 'counter = "N"', 'source[0].counter: no field is called "N"; fields are F, X'),
    (
        POLL + MAP + 'counter = "X"',
        'source[0].counter: the counter "X" is a float32; a counter must be an integer',
    ),
    (
        CAN + 'map = { force = "A.F", x1 = "A.X" }',
        "source[0].dbc: {folder}/none.dbc: No such file or directory",
    ),
    (RING + MAP, "source[0].ring: 9000 slots of 2 registers from 60000 end beyond register 65535"),
    (
        POLL + 'map = { force = "F" }\n' + TEXT + 'name = "b"\nmap = { x1 = "Z" }',
        'source[1].map.x1: no column is called "Z"; columns are F, X',
    ),
]


def faults_of(command: str, rig: Path) -> list[Fault]:
    """Return what a command says against a configuration."""
    if command == "check":
        found = check(config=rig, recording=None, probe=False)["errors"]
        return [Fault(error["path"], error["message"], error["advice"]) for error in found]
    rows = rig.with_name("rows.csv")
    rows.write_text(
        "t,force,x1\n" + "".join(f"{i / 200},{i % 7},{i % 5}\n" for i in range(90)), encoding="ascii"
    )
    started: dict[str, Callable[[], object]] = {
        "run": lambda: run(configs=[rig], db=rig.with_name("rig.db"), duration_s=1.0),
        "replay": lambda: replay(config=rig, recordings=[rows], db=None),
    }
    with pytest.raises(ConfigError) as refused:
        started[command]()
    return list(refused.value.faults)


@pytest.mark.parametrize("command", ["check", "run", "replay"])
@pytest.mark.parametrize(("sources", "words"), CASES)
def test_source_that_its_driver_refuses_is_named_with_its_number_and_key(
    sources: str, words: str, command: str, tmp_path: Path
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG + sources, encoding="utf-8")
    (fault,) = faults_of(command, rig)
    assert str(fault).startswith(words.format(folder=tmp_path))


def test_every_field_that_is_not_there_is_said(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG + TEXT + 'map = { force = "G", x1 = "H" }', encoding="utf-8")
    assert [fault.path for fault in faults_of("check", rig)] == ["source[0].map.force", "source[0].map.x1"]


def test_keys_that_are_missing_are_said_and_nothing_that_follows_from_it(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG + '[[source]]\ndriver = "modbus"\ntransport = "tcp"\nhost = "h"\n', encoding="utf-8")
    said = {fault.path: fault.message for fault in faults_of("check", rig)}
    assert said == dict.fromkeys(("source[0].map", "source[0].mode", "source[0].fields"), "is missing")
