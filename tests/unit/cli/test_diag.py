"""The bundle for support: the newest minute of raw samples, and texts without a secret."""

import json
import sqlite3
import tarfile
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from agent.cli.gateway.diag import diag, newest_samples
from agent.cli.gateway.redaction import Redaction
from agent.errors import StoreError, UsageError
from agent.recording import blocks
from agent.recording.header import RawHeader
from agent.storage.write.store import Store
from drivers.port import SampleBlock

S = 1_000_000_000


def recorded(folder: Path, seconds: int) -> Path:
    """Write a raw recording with a block a second, and one of frames; return the database beside them."""
    raw = folder / "rig.db.raw"
    raw.mkdir()
    header = RawHeader("line", ("force",), None, "ab" * 32, "0.1.0", 1, rig="press")
    made = [SampleBlock(np.full((2, 1), float(t)), t * S) for t in range(seconds)]
    (raw / "press-line-00000000.raw").write_bytes(b"older")
    content = blocks.encode_header(header) + b"".join(map(blocks.encode_block, made))
    (raw / "press-line-00000001.raw").write_bytes(content)
    (raw / "press-can-00000007.log").write_text("".join(f"({t}.5) can0 100#00\n" for t in range(seconds)))
    return folder / "rig.db"


def test_newest_minute_of_each_source_is_taken_from_its_newest_file(tmp_path: Path) -> None:
    found = dict(newest_samples(recorded(tmp_path, 150)))
    assert set(found) == {"press-line-00000001.raw", "press-can-00000007.log"}
    (tmp_path / "again.raw").write_bytes(found["press-line-00000001.raw"])
    again = list(blocks.read_blocks(tmp_path / "again.raw"))
    assert [block.arrival_ns // S for block in again] == list(range(89, 150))
    lines = found["press-can-00000007.log"].decode().splitlines()
    assert (lines[0], len(lines)) == ("(89.5) can0 100#00", 61)


def test_database_without_recordings_has_no_samples(tmp_path: Path) -> None:
    assert list(newest_samples(tmp_path / "rig.db")) == []


@pytest.mark.parametrize("text", [
    'password = "planted-1"', "password = 'planted-1'", 'x = { password = "planted-1", y = 2 }',
    '{"api_key": "planted-1"}', "mqtt_token: planted-1", "broker = mqtt://anna:planted-1@broker:1883",
    'secret = """\nplanted-1\n"""', "the broker refused planted-2", "env had planted-3",
    "a wrong planted-4 in a log", "passwort = 'planted-1'", "pwd: planted-1",
    "pass = planted-1", "db_pass=planted-1", "at mqtt://planted-1@broker",
    "at redis://:planted-1@broker", "at mqtt://anna:a@planted-1@broker", "at mqtt://anna:a/planted-1@broker",
    "curl -H 'Authorization: Bearer planted-1'", "-----BEGIN EC PRIVATE KEY-----\nplanted-1\n",
    "at https://hooks.example.org/services/T0/planted-5",
    'in JSON: planted\\"-6', "in an address: planted%22-6", "a credential: planted-7",
])  # fmt: skip
def test_no_secret_is_left_however_it_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    (tmp_path / "key").write_text("planted-2\n")
    monkeypatch.setenv("BROKER_PASSWORD", "planted-3")
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    (tmp_path / "handed-over").write_text("planted-7\n")
    (tmp_path / "quoted").write_text('planted"-6')
    config = tmp_path / "rig.toml"
    config.write_text(
        '[mqtt]\npassword = { file = "key" }\n[[north]]\n'
        'token = { env = "BROKER_PASSWORD" }\nsecret = "planted-4"\n'
        '[[north]]\npassword = { credential = "handed-over" }\n[[north]]\npassword = { file = "quoted" }\n'
        '[[notify]]\nurl = "https://hooks.example.org/services/T0/planted-5"\n'
    )
    cleaned = Redaction([config, tmp_path / "gone.toml"]).cleaned(text.encode()).decode()
    assert "planted" not in cleaned
    assert "REMOVED" in cleaned


def test_what_is_no_secret_stays_to_the_letter(tmp_path: Path) -> None:
    text = (
        '[mqtt]\npassword = { file = "key" }\n[rig]\nname = "press-7" # the tokens of hall 2\nk = [1.5e-3]\n'
        "compass = 3 # see https://example.org/manual, ask anna@example.org, basic settings\n"
    )
    assert Redaction([]).cleaned(text.encode()).decode() == text


RECURSIVE = (
    "CREATE VIEW {} AS WITH RECURSIVE n (key) AS (SELECT 1 UNION ALL SELECT key + 1 FROM n) SELECT key FROM n"
)


@pytest.mark.timeout(20)
def test_bundle_of_a_file_with_views_of_others_asks_none_of_them(tmp_path: Path) -> None:
    db, to = tmp_path / "rig.db", tmp_path / "bundle.tar.gz"
    Store.open(db).close()
    with closing(sqlite3.connect(db)) as file:
        file.execute("DROP VIEW v_meta")
        file.execute(RECURSIVE.format("v_meta"))
        file.commit()
    diag(db, to)
    with tarfile.open(to) as archive:
        meta, schema = (
            archive.extractfile(f"deltak-diag/database/{name}.json") for name in ("meta", "schema")
        )
        assert meta is not None
        assert b"the text of view v_meta is not its own" in meta.read()
        assert schema is not None
        assert "v_meta" in {row["name"] for row in json.load(schema)}


def test_bundle_is_readable_by_nobody_else_and_written_through_no_link(tmp_path: Path) -> None:
    db, to, others = tmp_path / "rig.db", tmp_path / "bundle.tar.gz", tmp_path / "others"
    Store.open(db).close()
    to.write_text("an older one")
    to.chmod(0o644)
    diag(db, to)
    assert to.stat().st_mode & 0o777 == 0o600
    others.write_text("as it was")
    to.unlink()
    to.symlink_to(others)
    with pytest.raises(UsageError, match="bundle"):
        diag(db, to)
    assert others.read_text() == "as it was"


def test_bundle_of_a_path_where_no_database_is_is_refused(tmp_path: Path) -> None:
    bundle = tmp_path / "b.tar.gz"
    with pytest.raises(StoreError, match="there is no such database"):
        diag(tmp_path / "typo.db", bundle)
    (tmp_path / "notes.txt").write_text("shopping: milk, bread")
    with pytest.raises(StoreError, match="this file is not a deltak database"):
        diag(tmp_path / "notes.txt", bundle)
    assert not bundle.exists()
