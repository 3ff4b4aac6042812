"""[[north]]: what a consumer needs, and what must not stand there."""

from pathlib import Path

import pytest

from agent.config.reading.secrets import Secret
from tests.unit.config.config_texts import MINIMAL, faults, read

BROKER = '[[north]]\nname = "plant"\nkind = "mqtt"\nurl = "mqtts://broker.example.org"\n'


def test_consumer_with_little_written_has_the_defaults() -> None:
    (consumer,) = read(MINIMAL + BROKER).north
    assert (consumer.name, consumer.kind, consumer.batch, consumer.timeout_s) == ("plant", "mqtt", 200, 10.0)
    assert consumer.topics == ("alarms", "estimates", "events", "health")
    assert (consumer.prefix, consumer.backfill, consumer.every) == ("deltak", True, 86400.0)


def test_parquet_archive_needs_a_folder_only() -> None:
    (consumer,) = read(
        MINIMAL + '[[north]]\nname = "a"\nkind = "parquet"\nfolder = "arc"\nevery = "1h"'
    ).north
    assert (consumer.folder, consumer.every, consumer.is_periodic) == (Path("arc"), 3600.0, True)


@pytest.mark.parametrize(
    ("text", "path", "words"),
    [
        ('kind = "mqtt"', "north[0].url", "is missing"),
        ('kind = "parquet"', "north[0].folder", "is missing"),
        ('kind = "mqtt"\nurl = "mqtt://user:hush@broker"', "north[0].url", "holds a password"),
        ('kind = "postgres"\nurl = "postgresql://db/x?password=hush"', "north[0].url", "holds a password"),
        ('kind = "postgres"\nurl = "postgresql://db/x?passw%6Frd=hush"', "north[0].url", "holds a password"),
        ('kind = "postgres"\nurl = "postgresql://u:#hush@db/x"', "north[0].url", "holds a password"),
        ('kind = "mqtt"\nurl = "http://broker"', "north[0].url", "no address of this kind"),
        ('kind = "mqtt"\nurl = "mqtt://broker"\nca = "ca.pem"', "north[0].url", "without TLS"),
        ('kind = "mqtt"\nurl = "mqtt://broker"\npassword = "hush"', "north[0].password", "must not stand"),
        ('kind = "mqtt"\nurl = "mqtt://broker"\npassword = { }', "north[0].password", "must name one place"),
        ('kind = "mqtt"\nurl = "mqtts://broker"\ncert = "c.pem"', "north[0].key", "is missing"),
        ('kind = "mqtt"\nurl = "mqtt://broker"\nprefix = "a/#"', "north[0].prefix", "without +"),
        ('kind = "sparkplug"\nurl = "mqtt://broker"\nprefix = "a/b"', "north[0].prefix", "group"),
        ('kind = "postgres"\nurl = "postgresql://db/x"\nprefix = "a-b"', "north[0].prefix", "is none"),
        ('kind = "mqtt"\nurl = "mqtt://broker"\nfolder = "arc"', "north[0].folder", "belongs to"),
        ('kind = "mqtt"\nurl = "mqtt://broker"\nparameters = ["k7"]', "north[0].parameters",
         "is not estimated"),
        ('kind = "mqtt"\nurl = "mqtt://broker"\ntopics = ["noise"]', "north[0].topics", ""),
        ('kind = "kafka"', "north[0].kind", "none of"),
    ],
)  # fmt: skip
def test_consumer_that_cannot_be_is_refused_where_it_stands(text: str, path: str, words: str) -> None:
    found = faults(f'{MINIMAL}[[north]]\nname = "plant"\n{text}')
    key, *_ = [key for key in found if key.startswith(path)]
    assert words in found[key]
    assert "hush" not in found[key]


def test_consumers_of_one_name_are_refused() -> None:
    assert "names must differ" in faults(MINIMAL + BROKER + BROKER)["north[1].name"]


def test_credential_is_read_from_the_folder_that_systemd_names(tmp_path: Path) -> None:
    (tmp_path / "broker").write_text("hush\n", encoding="utf-8")
    secret = Secret(credential="broker")
    assert secret.read(Path(), {"CREDENTIALS_DIRECTORY": str(tmp_path)}) == "hush"
    with pytest.raises(KeyError, match="CREDENTIALS_DIRECTORY"):
        secret.read(Path(), {})
