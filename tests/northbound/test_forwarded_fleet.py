"""`deltak fleet` of an archive says what it says of the databases; of a server see test_postgres."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from agent.cli.app import app
from agent.cli.prognosis.fleet import fleet
from agent.config.sections.north import North
from agent.errors import UsageError
from agent.northbound.interface.peer import Place
from agent.northbound.parquet.peer import ParquetPeer
from tests.northbound.forwarded import forwarded, same, worn

ARCHIVE = North(name="archive", kind="parquet", folder=Path("archive"))


def test_fleet_of_a_parquet_archive_says_what_it_says_of_the_databases(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("agent.cli.prognosis.fleet.FLEET_ROWS", 100)
    folder, archive = tmp_path / "databases", tmp_path / "archive"
    folder.mkdir()
    # rows, minutes and hours are read
    for rig, count, hop_s in (("press-0", 90, 60), ("press-1", 200, 20), ("press-2", 160, 900)):
        path = worn(folder, rig, count, hop_s)
        forwarded(path, ParquetPeer(ARCHIVE, Place(path, tmp_path)))
    answer = CliRunner().invoke(app, ["fleet", str(archive), "--json"])
    assert same(json.loads(answer.stdout)["rows"], folder)
    shown = CliRunner().invoke(app, ["fleet", str(archive / "estimates"), "--parameter", "k2"])
    assert shown.stdout.count("press-") == 3
    (day, *_) = sorted((archive / "estimates" / "rig=press-0").iterdir())
    (file, *_) = day.iterdir()
    file.write_bytes(b"PAR1")
    with pytest.raises(UsageError, match=f"{file}: cannot be read: .*; take it out of the archive"):
        fleet([archive], "90d", None, 20.0)
