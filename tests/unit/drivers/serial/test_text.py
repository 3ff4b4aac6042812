"""Lines of text, damaged, against a reader that goes through them character by character."""

import math
import re
from collections.abc import Callable

import numpy as np
import pytest
from pydantic import ValidationError

from drivers.port import Counts
from drivers.serial.driver import SerialSettings
from drivers.serial.text import TextDecoder

COLUMNS = ("n", "a", "b")
PATTERN = r"#(?P<n>\d+) F=(?P<a>[^ ]*) N x=(?P<b>[^ ]*) mm"
DIGITS = "0123456789"


def digits(text: str, place: int) -> int:
    while place < len(text) and text[place] in DIGITS:
        place += 1
    return place


def number(cell: str) -> float | None:
    """Read a decimal number as instruments write it; None when it is none, NaN for an empty cell."""
    text = cell.strip(" \t")
    if text in {"", "nan", "NaN", "NAN"}:
        return math.nan
    begin = 1 if text[0] in "+-" else 0
    whole = digits(text, begin)
    end = digits(text, whole + 1) if text[whole : whole + 1] == "." else whole
    some = whole > begin or end > whole + 1
    if text[end : end + 1] in {"e", "E"}:
        start = end + 1 + (text[end + 1 : end + 2] in {"+", "-"})
        end = digits(text, start)
        some &= end > start
    return float(text) if some and end == len(text) else None


def nmea(text: str) -> list[str] | None:
    _, dollar, rest = text.partition("$")
    body, star, sum_ = rest.rpartition("*")
    check = 0
    for character in body:
        check ^= ord(character)
    good = dollar and star and len(sum_) == 2 and f"{check:02X}" == sum_.upper()
    return body.split(",")[1:] if good else None


def labelled(text: str) -> list[str] | None:
    parts = text.split(" ")
    if len(parts) != 5 or parts[2] != "N" or parts[4] != "mm" or parts[0][:1] != "#":
        return None
    digits = parts[0][1:]
    good = digits.isdecimal() and parts[1][:2] == "F=" and parts[3][:2] == "x="
    return [digits, parts[1][2:], parts[3][2:]] if good else None


def independent(cells_of: Callable[[str], list[str] | None], stream: bytes) -> list[tuple[float, ...]]:
    out = []
    for line in stream.split(b"\n")[:-1]:
        text = line.decode("latin-1").strip("\r\n \0")
        cells = cells_of(text) if line.strip() and len(text) <= 1024 else None
        values = [number(cell) for cell in cells] if cells and len(cells) == 3 else [None]
        numbers = [value for value in values if value is not None and not math.isinf(value)]
        if len(numbers) == 3 and numbers[0] >= 0 and numbers[0] < 2**53 and numbers[0] % 1 == 0:
            out.append(tuple(numbers))
    return out


def nmea_line(n: int, a: float, b: float) -> bytes:
    body = f"RIG,{n},{a!r},{b!r}"
    check = 0
    for character in body:
        check ^= ord(character)
    return f"${body}*{check:02X}\r\n".encode()


KINDS: dict[str, tuple[Callable[[int, float, float], bytes], Callable[[str], list[str] | None]]] = {
    "nmea": (nmea_line, nmea),
    "columns": (lambda n, a, b: f"{n},{a!r},{b!r}\n".encode(), lambda text: text.split(",")),
    "pattern": (lambda n, a, b: f"#{n} F={a!r} N x={b!r} mm\r\n".encode(), labelled),
}


def decoder(kind: str) -> tuple[TextDecoder, Counts]:
    counts = Counts()
    pattern = re.compile(PATTERN) if kind == "pattern" else None
    delimiter = None if kind == "pattern" else ","
    made = TextDecoder(COLUMNS, delimiter, pattern, kind == "nmea", COLUMNS, "n", counts)
    made.feed(b"\n")
    counts.faults.clear()
    return made, counts


@pytest.mark.parametrize("kind", sorted(KINDS))
@pytest.mark.parametrize(
    "count", [15_000, pytest.param(10_000_000, marks=[pytest.mark.soak, pytest.mark.timeout(3600)])]
)
def test_mutated_lines_are_read_as_an_independent_reader_reads_them(
    rng: np.random.Generator, kind: str, count: int
) -> None:
    batch = 1_500
    write, cells_of = KINDS[kind]
    good = [write(n, *rng.normal(0, [1e3, 1e-4]).tolist()) for n in range(batch)]
    for _ in range(count // batch):
        lines = good.copy()
        for place in rng.choice(batch, batch // 3, replace=False).tolist():
            lines[place] = mutated(lines[place], rng)
        stream = b"".join(lines)
        made, counts = decoder(kind)
        cut = int(rng.integers(len(stream)))
        (early, n), (late, m) = made.feed(stream[:cut]), made.feed(stream[cut:])
        assert n is not None
        assert m is not None
        expected = np.array(independent(cells_of, stream)).reshape(-1, 3)
        np.testing.assert_array_equal(np.concatenate([early, late]), expected)
        np.testing.assert_array_equal(np.concatenate([n, m]), expected[:, 0])
        assert counts.received == len(expected) + counts.rejected.total()


LIKELY = np.frombuffer(b"0123456789+-.eE,*$# \t_nainf\xb2\x85\xff\x00\n", np.uint8)


def mutated(line: bytes, rng: np.random.Generator) -> bytes:
    data = bytearray(line)
    for kind, place, value in rng.integers(
        (0, 0, 0), (4, 1 << 16, len(LIKELY)), (int(rng.integers(1, 4)), 3)
    ).tolist():
        if kind == 0:
            data[place % len(data)] ^= 1 << value % 8
        elif kind == 1:
            data.insert(place % (len(data) + 1), int(LIKELY[value]))
        elif kind == 2:
            data[place % len(data)] = int(LIKELY[value])
        elif len(data) > 1:
            del data[place % len(data)]
    return bytes(data)


def noted(line: bytes, columns: tuple[str, ...], pattern: str | None = None, *, nmea: bool = True) -> str:
    notes: list[str] = []
    compiled = re.compile(pattern) if pattern else None
    decoder = TextDecoder(
        columns, None if pattern else ",", compiled, nmea, columns, None, Counts(), notes.append
    )
    decoder.feed(b"\n" + 3 * line)
    (note,) = notes
    return note


XDR, BAD_SUM = b"$IIXDR,1,2*4D\r\n", b"$IIXDR,1,2*4C\r\n"


@pytest.mark.parametrize(
    ("line", "keys", "words"),
    [
        (XDR, {}, "'$IIXDR,1,2*4D': 2 cells behind its address, which with $ is no column; columns has 3"),
        (BAD_SUM, {}, 'checksum = "nmea" wants $ADDRESS,cells*HH, HH the exclusive or'),
        (
            XDR, {"pattern": "(?P<n>.)(?P<a>.)(?P<b>.)"},
            "does not match the pattern, held against what lies between $ and *, the address included",
        ),
        (b"1,2\n", {"nmea": False}, "rejected as \"columns\": '1,2': 2 cells; columns has 3"),
        (b"1,2,\x1b[2J\n", {"nmea": False},
         "rejected as \"text\": '1,2,\\x1b[2J': a cell is no decimal number"),
    ],
)  # fmt: skip
def test_first_line_that_is_rejected_for_a_reason_is_shown_with_why(
    line: bytes, keys: dict[str, object], words: str
) -> None:
    assert words in noted(line, COLUMNS, **keys)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"columns": ["$IIXDR", "a"]}, r"columns: with checksum = \"nmea\" a line is \$ADDRESS,cells\*HH"),
        (
            {"pattern": r"\$IIXDR,(?P<a>[^,]*)"},
            r"pattern: with checksum = \"nmea\" .* leave the dollar sign out",
        ),
        ({"pattern": r"^[$]IIXDR,(?P<a>[^,]*)"}, r"pattern: with checksum = \"nmea\""),
    ],
)
def test_nmea_with_its_dollar_in_columns_or_pattern_is_refused_in_words(
    keys: dict[str, object], words: str
) -> None:
    with pytest.raises(ValidationError, match=words):
        SerialSettings.model_validate({"port": "x", "format": "text", "checksum": "nmea", **keys})


def test_nmea_pattern_that_begins_with_the_address_is_taken() -> None:
    keys = {"port": "x", "format": "text", "checksum": "nmea", "pattern": r"IIXDR,(?P<a>[^,]*)"}
    assert SerialSettings.model_validate(keys).pattern


def test_line_without_end_is_shown_as_it_begins() -> None:
    text, counts = decoder("nmea")
    text.feed(b"1,2,\x1b3,\xff" * 300)
    assert counts.first["stray bytes"].startswith("'1,2,\\x1b3,\\xff1,2,")
    assert counts.first["stray bytes"].endswith("': no line feed within 1024 characters")
