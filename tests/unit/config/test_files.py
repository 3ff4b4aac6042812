"""Files as they come: encodings, rubbish, what cannot be opened, several at once."""

import hashlib
import os
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.config import load, load_many, parse
from agent.config.tuning import FILE_BYTES
from agent.errors import ConfigError, Fault
from tests.unit.config.config_texts import FILE, MINIMAL, MOTOR, PRESS, changed, with_fake_driver


@pytest.fixture(scope="module", autouse=True)
def _fake_driver() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        with_fake_driver(patch)
        yield


def put(folder: Path, text: str, name: str = "rig.toml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def words_of(path: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        load(path)
    return str(caught.value)


def test_load_file_knows_its_place_and_its_sha256(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put(tmp_path, MINIMAL)
    monkeypatch.chdir(tmp_path)
    config = load("rig.toml")
    assert (config.file, config.folder) == (tmp_path / "rig.toml", tmp_path)
    assert config.sha256 == hashlib.sha256(MINIMAL.encode()).hexdigest()
    assert config.store.path == tmp_path / "bench.db"


@pytest.mark.parametrize(
    "encode", [lambda s: b"\xef\xbb\xbf" + s.encode(), lambda s: s.replace("\n", "\r\n").encode()]
)
def test_load_file_of_a_windows_editor_is_read(encode: object) -> None:
    assert parse(encode(MINIMAL), FILE).rig.name == "bench"  # type: ignore[operator]


def test_load_missing_file_says_so(tmp_path: Path) -> None:
    assert words_of(tmp_path / "no.toml") == (
        f"{tmp_path / 'no.toml'}: cannot be read: No such file or directory; name a configuration file"
    )


def test_load_directory_says_so(tmp_path: Path) -> None:
    assert "Is a directory" in words_of(tmp_path)


def test_load_name_with_a_zero_byte_says_so(tmp_path: Path) -> None:
    assert "cannot be read" in words_of(tmp_path / "a\0b")


@pytest.mark.parametrize(
    ("data", "line", "words"),
    [
        (b"[rig]\nname = \n", 2, "is not TOML"),
        (b"[rig]\n\nname = 'a\n", 3, "is not TOML"),
        (b"[rig]\nname = [1,\n", 2, "is not TOML"),
        (b"[rig]\nname = 1\nname = 2\n", 3, "cannot overwrite"),
        (b"[rig]\nname = 'M\xfcller'\n", 2, "is not UTF-8"),
        (b"[rig]\rname = 1", 1, "is not TOML"),
        (b"\x00\x01\x02", 1, "is not TOML"),
    ],
)
def test_load_text_that_is_not_toml_names_file_and_line(data: bytes, line: int, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse(data, FILE)
    (fault,) = caught.value.faults
    assert fault.path == f"{FILE}:{line}"
    assert words in str(fault)
    assert str(fault).isprintable()


@pytest.mark.parametrize(
    "opening",
    ["a = " + "[" * 100_000, "a = " + "{ a = " * 50_000, "a." * 100_000 + "b = 1", "'a' ." * 99_999],
)
def test_load_text_nested_without_end_is_refused_in_words(opening: str) -> None:
    with pytest.raises(ConfigError):
        parse(opening.encode(), FILE)


def test_load_ten_megabytes_of_rubbish_are_refused_in_words(tmp_path: Path) -> None:
    path = tmp_path / "big.toml"
    path.write_bytes(os.urandom(1_000_000) * 10)
    assert f"is larger than {FILE_BYTES // 1_000_000} MB" in words_of(path)


def test_load_five_thousand_channels_answers(tmp_path: Path) -> None:
    more = "".join(f'[[channel]]\nname="c{i}"\nquantity="force"\nat="q"\nunit="N"\n' for i in range(5000))
    assert 'channel[5000].at: no mass is called "q"; masses are m' in words_of(put(tmp_path, MINIMAL + more))


def test_load_many_reads_all(tmp_path: Path) -> None:
    paths = [put(tmp_path, MINIMAL, "a.toml"), put(tmp_path, MOTOR, "b.toml")]
    assert [config.rig.name for config in load_many(paths)] == ["bench", "motor"]


def test_load_many_with_faults_names_the_file_of_each(tmp_path: Path) -> None:
    first = put(tmp_path, changed(MINIMAL, ("200", "0")), "a.toml")
    second = put(tmp_path, "x = = 1", "b.toml")
    with pytest.raises(ConfigError) as caught:
        load_many([first, second, tmp_path / "c.toml"])
    paths = [fault.path for fault in caught.value.faults]
    assert paths == [f"{first}: rig.sample_rate_hz", f"{second}:1", f"{tmp_path / 'c.toml'}"]


def test_load_many_of_one_rig_twice_is_refused(tmp_path: Path) -> None:
    first, second = put(tmp_path, MINIMAL, "a.toml"), put(tmp_path, MINIMAL, "b.toml")
    with pytest.raises(ConfigError, match=r'rig\.name: "bench" is the rig of'):
        load_many([first, second])
    with pytest.raises(ConfigError, match="rig"):
        load_many([first, first])


def test_load_many_of_one_store_must_agree_on_it(tmp_path: Path) -> None:
    first = put(tmp_path, MINIMAL + '[store]\npath = "all.db"\n', "a.toml")
    second = put(tmp_path, MOTOR + '[store]\npath = "all.db"\nmax_mb = 5\n', "b.toml")
    with pytest.raises(ConfigError) as caught:
        load_many([first, second])
    assert [fault.path for fault in caught.value.faults] == [f"{second}: store.max_mb"]
    second.write_text(MOTOR + '[store]\npath = "all.db"\n')
    assert len({config.store.path for config in load_many([first, second])}) == 1


BESIDE = """
[[channel]]
name = "hall"
role = "covariate"
unit = "degC"
range = [0.0, 40.0]
[columns]
t = "time"
[baseline]
covariates = ["hall"]
[forecast]
every = "1h"
"""
"""What stands beside the model, its channels and its alarms."""

VALUES = (
    ["0", "-1", "1e400", "nan", "inf", '""', '"x"', '"\\u0000"', "true", "[]", "{}", "[[]]", "[1, 'a']",
     "{ a = 1 }", "1" * 400, "1979-05-27", "07:32:00", "1979-05-27T07:32:00Z", '"ground"', '"m1"',
     "'''\n'''", '["m1", "m1"]']
)  # fmt: skip


@st.composite
def mutated_texts(draw: st.DrawFn) -> str:
    """A right file with some values exchanged, lines dropped, doubled or moved, keys misspelt."""
    lines = draw(st.sampled_from([PRESS, MINIMAL, MOTOR])).splitlines()
    for _ in range(draw(st.integers(1, 6))):
        i = draw(st.integers(0, len(lines) - 1))
        kind = draw(st.sampled_from(["value", "drop", "double", "move", "key", "inner"]))
        if kind == "value" and "=" in lines[i]:
            lines[i] = f"{lines[i].partition('=')[0]}= {draw(st.sampled_from(VALUES))}"
        elif kind == "inner" and "= " in lines[i]:
            at = draw(st.sampled_from([k for k in range(len(lines[i])) if lines[i].startswith("= ", k)]))
            end = min((k for k in (lines[i].find(c, at) for c in ",}]") if k > 0), default=len(lines[i]))
            lines[i] = f"{lines[i][:at]}= {draw(st.sampled_from(VALUES))}{lines[i][end:]}"
        elif kind == "drop":
            lines[i] = ""
        elif kind == "double":
            lines.insert(i, lines[i])
        elif kind == "move":
            lines.insert(draw(st.integers(0, len(lines) - 1)), lines.pop(i))
        elif kind == "key":
            lines[i] = "q" + lines[i]
    return "\n".join(lines)


@pytest.mark.parametrize("value", [*VALUES, "9" * 5000], ids=lambda value: value[:20])
def test_parse_of_a_value_in_any_place_gives_a_configuration_or_words(value: str) -> None:
    for text in (PRESS, MINIMAL, MOTOR, BESIDE):
        for at in (match.end() for match in re.finditer(r"= ", text)):
            end = min(k for k in (text.find(c, at) for c in ",}\n") if k > 0)
            changed = f"{text[:at]}{value}{text[end:]}"
            assert_configuration_or_words((changed if text is not BESIDE else MINIMAL + changed).encode())


@given(mutated_texts())
def test_parse_of_any_mutation_gives_a_configuration_or_words(text: str) -> None:
    assert_configuration_or_words(text.encode())


@given(st.binary(max_size=300) | st.text(max_size=300).map(str.encode))
def test_parse_of_any_bytes_gives_a_configuration_or_words(data: bytes) -> None:
    assert_configuration_or_words(data)


def assert_configuration_or_words(data: bytes) -> None:
    found: tuple[Fault, ...] = (Fault("", "read without fault"),)
    try:
        parse(data, FILE)
    except ConfigError as error:
        found = error.faults
    assert found
    assert all(str(fault).isprintable() and "None" not in fault.message for fault in found)


INDEPENDENT = [
    ("sample_rate_hz = 1000.0", "sample_rate_hz = -3", "rig.sample_rate_hz"),
    ("nominal = 25.0", "nominal = nan", "model.spring[0].nominal"),
    ('at = "m2"\nunit = "N"', 'at = "m9"\nunit = "N"', "channel[0].at"),
    ('unit = "m"\nnoise', 'unit = "kg"\nnoise', "channel[1].unit"),
    ("noise_sd = 1e-6", "noise_sd = 0", "channel[1].noise_sd"),
    ("bias = false", "bais = false", "channel[1].bais"),
    ('hold = "first"', 'hold = "third"', "estimator.hold"),
    ("resolve = 0.33", "resolve = -1", "estimator.resolve"),
    ("limit = 15.0", "limit = 15.0\nlimit_percent = 3", "alarm[0]"),
    ('side = "both"', 'side = "left"', "alarm[0].side"),
    ('interface = "socketcan"', 'interface = "x"', "source[0].interface"),
    ('counter = "RIG', 'countr = "RIG', "source[0].countr"),
    ("every_s = 1.0", "every_s = -1", "store.every_s"),
    ('full = "7d"', 'full = "x"', "store.keep.full"),
    ("[store]", "[http]\n[store]", "http"),
]


@given(st.sets(st.sampled_from(INDEPENDENT), min_size=1))
def test_parse_of_several_faults_names_each_of_them_and_no_other(rows: set[tuple[str, str, str]]) -> None:
    text = changed(PRESS, *((old, new) for old, new, _ in sorted(rows)))
    with pytest.raises(ConfigError) as caught:
        parse(text.encode(), FILE)
    assert {fault.path for fault in caught.value.faults} == {path for _, _, path in rows}
