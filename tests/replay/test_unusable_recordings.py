"""Recordings that nothing or little can be made of are refused or warned of, with what to do about it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from agent.commissioning.check import check
from agent.errors import RecordingError
from agent.runtime.replay import replay
from agent.runtime.usability import Evidence
from drivers.port import FloatArray
from tests.scenario.live import example
from tests.unit.numerics.rigs import noisy

ROWS = 700
LINE = Callable[[float, FloatArray], str]


def comma(t: float, v: FloatArray) -> str:
    """A row as spreadsheets of half the world write it."""
    return ";".join(f"{value:.9f}".replace(".", ",") for value in (t, *v))


def plain(t: float, v: FloatArray) -> str:
    """A row as it should be."""
    return ",".join(f"{value:.9f}" for value in (t, *v))


def written(folder: Path, times: FloatArray, line: LINE = plain) -> Path:
    """Write a recording of a healthy rig with these times."""
    v = noisy(np.random.default_rng(3), len(times), 1e-6).v[:, [2, 0, 1]]
    head = "t;force;x1;x2" if line is comma else "t,force,x1,x2"
    path = folder / "recording.csv"
    path.write_text(
        "\n".join([head, *(line(t, row) for t, row in zip(times.tolist(), v, strict=True))]) + "\n"
    )
    return path


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """A rig of 1 kHz without sources."""
    text = example("modbus", tmp_path).read_text(encoding="utf-8")
    path = tmp_path / "rig.toml"
    path.write_text(text[: text.index("[[source]]")], encoding="utf-8")
    return path


SECONDS = np.arange(ROWS) / 1000.0
USELESS: dict[str, tuple[FloatArray, LINE, str]] = {
    "decimal commas": (SECONDS, comma, "decimal commas"),
    "backwards": (SECONDS[::-1], plain, "backwards from row to row; sort"),
    "beyond": (SECONDS + 1.7e12, plain, "are no seconds"),
    "milliseconds": (SECONDS * 1e3, plain, "in milliseconds: it must be in seconds"),
    "microseconds": (SECONDS * 1e6, plain, "in microseconds"),
}


@pytest.mark.parametrize("case", USELESS)
def test_recording_of_no_use_is_refused_with_what_to_do(case: str, tmp_path: Path, config: Path) -> None:
    times, line, words = USELESS[case]
    path = written(tmp_path, times, line)
    with pytest.raises(RecordingError, match=words) as caught:
        replay(config=config, recordings=[path], db=None)
    assert caught.value.exit_code == 2
    assert all(fault.advice and fault.path == str(path) for fault in caught.value.faults)


def test_recording_of_no_use_is_refused_by_check_in_the_same_words(tmp_path: Path, config: Path) -> None:
    with pytest.raises(RecordingError, match="decimal commas"):
        check(config=config, recording=written(tmp_path, SECONDS, comma), probe=False)


@pytest.mark.parametrize(
    ("times", "rate"), [(np.arange(10 * ROWS) / 1e4, 10_000), (np.arange(ROWS) / 100.0, 100)]
)
def test_recording_at_another_rate_is_warned_of(
    times: FloatArray, rate: int, tmp_path: Path, config: Path, caplog: pytest.LogCaptureFixture
) -> None:
    document = replay(config=config, recordings=[written(tmp_path, times)], db=None)
    (words,) = [text for text in document["advice"] if "sample_rate_hz" in text]
    assert f"set rig.sample_rate_hz = {rate}" in words
    assert words in [record.getMessage() for record in caplog.records]


def test_cells_that_are_no_numbers_are_counted_in_the_document(tmp_path: Path, config: Path) -> None:
    path = written(tmp_path, SECONDS)
    lines = path.read_text(encoding="utf-8").split("\n")
    lines[300] = lines[300][:-4] + "oops"
    path.write_text("\n".join(lines), encoding="utf-8")
    assert replay(config=config, recordings=[path], db=None)["faults"] == {"text": 1}


def test_recording_that_fits_is_not_warned_of(
    tmp_path: Path, config: Path, caplog: pytest.LogCaptureFixture
) -> None:
    jitter = np.random.default_rng(1).uniform(-2e-4, 2e-4, ROWS)
    document = replay(config=config, recordings=[written(tmp_path, SECONDS + jitter)], db=None)
    assert document["advice"] == []
    assert document["samples"]["used"] == ROWS
    assert not caplog.records


FRAME = "({t:.6f}) {wire} {number}#{data}"


def logged(folder: Path, number: str = "100", wire: str = "can0", rows: int = ROWS) -> Path:
    """Write a candump log of a rig that stands still, its frames under an identifier."""
    path = folder / f"{wire}-{number}.log"
    frames = (
        FRAME.format(
            t=1.6e9 + i / 1000, wire=wire, number=number, data=f"{i % 256:02X}{i // 256:02X}{'0' * 12}"
        )
        for i in range(rows)
    )
    path.write_text("\n".join([*frames, ""]), encoding="ascii")
    return path


def test_can_log_without_a_frame_that_fits_is_refused_with_what_is_in_it(tmp_path: Path) -> None:
    path = logged(tmp_path, "101")
    with path.open("a", encoding="ascii") as file:
        file.write("(1600000009.000000) can0 0CFF1027#00\n" * 7)
    with pytest.raises(RecordingError) as caught:
        replay(config=example("can", tmp_path), recordings=[path], db=None)
    assert caught.value.exit_code == 2
    (fault,) = caught.value.faults
    assert fault.path == str(path)
    assert fault.message.startswith(f"none of its {ROWS + 7} frames fits")
    assert f"seen are 101 ({ROWS} times), 0CFF1027 (7 times)" in fault.message
    assert "looked for is RIG_SAMPLE (100)" in fault.message
    with pytest.raises(RecordingError, match="none of its"):
        check(config=tmp_path / "can.toml", recording=path, probe=False)


def test_can_log_without_a_frame_that_fits_is_warned_of_beside_one_that_fits(tmp_path: Path) -> None:
    logs = [logged(tmp_path, "101"), logged(tmp_path)]
    document = replay(config=example("can", tmp_path), recordings=logs, db=None)
    assert document["samples"]["used"] == ROWS
    assert [
        text for text in document["advice"] if text.startswith(f"{logs[0]}: none of its {ROWS} frames fits")
    ]


def test_can_log_that_ends_in_damage_is_warned_of() -> None:
    evidence = Evidence(1000.0)
    evidence.notes = ["/a.asc: is damaged, its end is not read: ValueError('no')", "/a.asc: is short"]
    words = "/a.asc: is damaged, its end is not read; what stands before that is used"
    assert list(map(str, evidence.damaged())) == [words]


@pytest.mark.parametrize(
    ("text", "place", "what"),
    [
        (None, "", "No such file or directory"),
        ("", "", "is empty"),
        ("\n", ":1", "is blank"),
        ("force,x1,x2\n1,2,3\n", "", 'no column is called "t"'),
    ],
)
def test_recording_that_cannot_be_read_is_the_place_of_its_fault(
    text: str | None, place: str, what: str, tmp_path: Path, config: Path
) -> None:
    path = tmp_path / "recording.csv"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(RecordingError) as caught:
        replay(config=config, recordings=[path], db=None)
    (fault,) = caught.value.faults
    assert (fault.path, fault.message) == (f"{path}{place}", what)
    assert fault.advice


def test_column_that_no_channel_names_is_noted_once(
    tmp_path: Path, config: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = written(tmp_path, SECONDS, lambda t, v: f"{plain(t, v)},7")
    path.write_text(path.read_text().replace("x2\n", "x2,oil\n", 1), encoding="utf-8")
    with caplog.at_level("WARNING"):
        replay(config=config, recordings=[path], db=None)
    (note,) = [record.getMessage() for record in caplog.records if "oil" in record.getMessage()]
    assert note == f"{path}: columns that no channel names are ignored: oil"
