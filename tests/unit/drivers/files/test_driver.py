from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from drivers.files.driver import RecordingDriver, RecordingSettings
from drivers.port import DriverConfigError, SampleBlock, SourceRequest

FIELDS = ("force", "x1")


def driver(path: Path, **settings: object) -> RecordingDriver:
    return RecordingDriver(SourceRequest("recording", RecordingSettings(path=path, **settings), FIELDS))


def blocks_of(recording: RecordingDriver) -> Iterator[SampleBlock]:
    while True:
        try:
            yield recording.read(0.0)
        except EOFError:
            return


def everything(recording: RecordingDriver) -> SampleBlock:
    recording.open()
    blocks = list(blocks_of(recording))
    recording.close()
    times = [block.t_ns for block in blocks if block.t_ns is not None]
    return SampleBlock(
        np.concatenate([block.values for block in blocks]), 0, None, np.concatenate(times) if times else None
    )


def written(folder: Path, text: str | bytes, name: str = "a.csv") -> Path:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


@pytest.mark.parametrize(
    "text",
    [
        "t,force,x1\n0,1,2\n0.001,3,-4e-3\n",
        "x1;t;force\r\n2;0;1\r\n-4e-3;0.001;3\r\n",
        "\ufefft\tforce\tx1\n0\t1\t2\n0.001\t3\t-0.004",
        't,"force",x1\n0,"1",2\n\n1970-01-01T00:00:00.001Z,3,-0.004\n\n',
        "t,force,x1\n0, 1,2 \n1e-3,3,-0.004\n",
    ],
)
def test_csv_in_its_dialects_gives_the_same_samples(tmp_path: Path, text: str) -> None:
    samples = everything(driver(written(tmp_path, text)))
    np.testing.assert_array_equal(samples.values, [[1, 2], [3, -0.004]])
    assert samples.t_ns is not None
    assert samples.t_ns.tolist() == [0, 1_000_000]


def test_csv_with_empty_cells_gives_missing_values_without_fault(tmp_path: Path) -> None:
    recording = driver(written(tmp_path, "force,t,x1\n,0,2\n3,0.001,\n,0.002,\n"))
    samples = everything(recording)
    np.testing.assert_array_equal(samples.values, [[np.nan, 2], [3, np.nan], [np.nan, np.nan]])
    assert not recording.counts.faults
    assert recording.counts.received == 3


def test_csv_with_text_in_cells_counts_them_and_names_their_lines(tmp_path: Path) -> None:
    path = written(tmp_path, "t,force,x1\n0,1,2\n0.001,hello,4\n0.002,inf,6\nx,7,8\n0.004,9,10\n")
    recording = driver(path)
    samples = everything(recording)
    np.testing.assert_array_equal(samples.values, [[1, 2], [np.nan, 4], [np.nan, 6], [9, 10]])
    assert recording.counts.faults == {"text": 3}
    assert recording.counts.rejected == {"time": 1}
    assert recording.counts.received == 5
    notes = recording.take_notes()
    assert notes[0].startswith(f'{path}:3: force: "hello" is no number')
    assert [note.split(":")[1] for note in notes] == ["3", "4", "5"]


def test_csv_lines_after_the_first_piece_are_numbered_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.files.csv_file.BLOCK_ROWS", 10)
    rows = [f"{i / 1000},{i},{i}" for i in range(100)]
    rows[77] = "0.077,bad,77"
    recording = driver(written(tmp_path, "\n".join(["t,force,x1", *rows])))
    assert len(everything(recording).values) == 100
    assert "a.csv:79: force" in recording.take_notes()[0]


def test_csv_rows_that_are_too_short_or_long_are_read_as_far_as_they_go(tmp_path: Path) -> None:
    samples = everything(driver(written(tmp_path, "t,force,x1\n0,1\n0.001,3,4,5\n")))
    np.testing.assert_array_equal(samples.values, [[1, np.nan], [3, 4]])


def test_csv_with_columns_nobody_names_notes_them_once(tmp_path: Path) -> None:
    recording = driver(written(tmp_path, "t,force,Temp,x1,Door\n0,1,a,2,b\n"))
    np.testing.assert_array_equal(everything(recording).values, [[1, 2]])
    assert len(recording.take_notes()) == 1


def test_csv_with_renamed_columns_is_read_by_their_names(tmp_path: Path) -> None:
    path = written(tmp_path, "Time,Encoder 1 Pos,force\n0.5,2,1\n")
    samples = everything(driver(path, columns={"x1": "Encoder 1 Pos", "t": "Time"}))
    np.testing.assert_array_equal(samples.values, [[1, 2]])


def test_csv_without_time_is_read_with_the_uniform_clock_only(tmp_path: Path) -> None:
    path = written(tmp_path, "force,x1\n1,2\n3,4\n")
    samples = everything(driver(path, clock="uniform"))
    assert samples.t_ns is None
    with pytest.raises(DriverConfigError, match='no column is called "t"; columns are force, x1'):
        driver(path).open()


def test_csv_with_unreadable_times_and_the_uniform_clock_keeps_every_row(tmp_path: Path) -> None:
    recording = driver(written(tmp_path, "t,force,x1\n1,1,2\n?,3,4\n3,5,6\n"), clock="uniform")
    samples = everything(recording)
    assert samples.t_ns is not None
    assert samples.t_ns.tolist() == [10**9, 10**9, 3 * 10**9]
    assert recording.counts.rejected.total() == 0


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"t,force,x1\n", "a header and no rows"),
        (b"0,1,2\n0.001,3,4\n", "holds numbers and no names"),
        (b"\x89PNG\r\n\x1a\n\x00\x01\xff", "is not text"),
        (bytes(range(256)) * 100, "is not text"),
        (b"\x1f\x8b\x08\x00", "or a CAN log .*; unpack what is compressed"),
        ("t,force,x1,Weg µm\n0,1,2,3\n".encode("latin-1"), "not of UTF-8; .*iconv -f WINDOWS-1252 -t UTF-8"),
        ("t,force,x1\n0,1,2\n".encode("utf-16"), "not of UTF-8; .*iconv -f UTF-16 -t UTF-8"),
        (b"\n1,2\n", "is blank"),
        (b"t,force,x1\r0,1,2\r", "lines that end in a carriage return alone; save it with line feeds"),
        (b"t,force,x1," + b"y" * (1 << 20), "a first line of more than 1048576 bytes is not read"),
        (b"t,force,y\n0,1,2\n", 'no column is called "x1"; columns are t, force, y; say under .columns.'),
        (b"t force x1\n0 1 2\n", "columns are t force x1; between columns stand commas, semicolons or tabs"),
        (b"t,force,x1,x1\n0,1,2,3\n", '2 columns are called "x1"'),
    ],
)
def test_csv_that_cannot_be_used_is_refused_in_words(tmp_path: Path, content: bytes, words: str) -> None:
    with pytest.raises(DriverConfigError, match=words):
        driver(written(tmp_path, content)).open()


def test_recording_that_is_missing_is_refused_in_words(tmp_path: Path) -> None:
    for name in ("none.csv", "none.npz"):
        with pytest.raises(DriverConfigError, match="No such file"):
            driver(tmp_path / name).open()


def test_csv_of_rubbish_after_a_good_header_raises_nothing(tmp_path: Path, rng: np.random.Generator) -> None:
    recording = driver(written(tmp_path, b"t,force,x1\n" + rng.integers(0, 256, 20_000, np.uint8).tobytes()))
    samples = everything(recording)
    assert recording.counts.received == len(samples.values) + recording.counts.rejected.total()


@pytest.mark.parametrize("compressed", [False, True])
def test_npz_is_read_in_blocks_as_it_was_saved(
    tmp_path: Path, rng: np.random.Generator, compressed: bool
) -> None:
    t, force, x1 = (
        np.arange(150_000) / 1000,
        rng.normal(size=150_000),
        rng.integers(-9, 9, 150_000).astype(np.int16),
    )
    save = np.savez_compressed if compressed else np.savez
    save(tmp_path / "a.npz", t=t, force=force, x1=x1, other=t)
    recording = driver(tmp_path / "a.npz")
    samples = everything(recording)
    np.testing.assert_array_equal(samples.values, np.column_stack([force, x1]))
    assert samples.t_ns is not None
    np.testing.assert_array_equal(samples.t_ns, np.arange(150_000) * 1_000_000)
    assert "other" in recording.take_notes()[0]


def test_npz_times_of_an_epoch_are_not_rounded_twice(tmp_path: Path) -> None:
    t = np.array([1_700_000_000.123456, 1_700_000_000.5])
    np.savez(tmp_path / "a.npz", t=t, force=t, x1=t)
    samples = everything(driver(tmp_path / "a.npz"))
    assert samples.t_ns is not None
    assert samples.t_ns.tolist() == [round(Fraction(float(x)) * 10**9) for x in t]


def npz_of(folder: Path, **arrays: object) -> Path:
    np.savez(folder / "a.npz", **arrays)  # type: ignore[arg-type]
    return folder / "a.npz"


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"t": [0.0], "force": [1.0]}, 'no column is called "x1"; columns are t, force'),
        ({"t": [0.0], "force": [1.0], "x1": [1.0, 2.0]}, "different lengths"),
        ({"t": [], "force": [], "x1": []}, "are empty"),
        ({"t": [0.0], "force": [1.0], "x1": [[1.0]]}, "a row of numbers is needed"),
        ({"t": [0.0], "force": [1.0], "x1": ["a"]}, "a row of numbers is needed"),
        ({"t": [0.0], "force": [1.0], "x1": np.array([None], object)}, "a row of numbers is needed"),
    ],
)
def test_npz_that_cannot_be_used_is_refused_in_words(
    tmp_path: Path, arrays: dict[str, object], words: str
) -> None:
    with pytest.raises(DriverConfigError, match=words):
        driver(npz_of(tmp_path, **arrays)).open()


def test_npz_of_rubbish_or_cut_short_is_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(DriverConfigError, match="is no NPZ file"):
        driver(written(tmp_path, b"\x00\xff" * 999, "b.npz")).open()
    whole = npz_of(tmp_path, t=np.arange(9.0), force=np.arange(9.0), x1=np.arange(9.0)).read_bytes()
    for size in range(0, len(whole), 97):
        with pytest.raises(DriverConfigError):
            driver(written(tmp_path, whole[:size], "c.npz")).open()


def test_npz_with_a_flipped_bit_is_refused_or_read_to_its_end(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    whole = bytearray(
        npz_of(tmp_path, t=np.arange(99.0), force=np.arange(99.0), x1=np.arange(99.0)).read_bytes()
    )
    ends = []
    for place in rng.integers(0, len(whole), 150):
        damaged = whole.copy()
        damaged[place] ^= 1 << int(rng.integers(8))
        recording = driver(written(tmp_path, bytes(damaged), "d.npz"))
        try:
            recording.open()
            while True:
                recording.read(0.0)
        except DriverConfigError:
            ends.append("refused")
        except EOFError:
            ends.append("read")
            assert recording.counts.received <= 99
        finally:
            recording.close()
    assert (len(ends), set(ends)) == (150, {"refused", "read"})


def test_csv_whose_first_row_is_very_long_is_read_in_pieces_that_fit_into_memory(tmp_path: Path) -> None:
    recording = driver(written(tmp_path, f"t,force,x1\n{'1' * 3_000_000}\n0.001,1,2\n"))
    assert everything(recording).values[-1].tolist() == [1.0, 2.0]
    assert recording.counts.rejected.total() == 1
