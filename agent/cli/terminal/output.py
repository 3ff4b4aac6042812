"""What goes to stdout: JSON documents, CSV, tables; and errors, one a line, on stderr."""

import csv
import json
import math
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from agent.cli.tuning import PLAIN_WIDTH
from agent.errors import Fault
from agent.text import iso_time, printable

if TYPE_CHECKING:
    from _typeshed import SupportsWrite
    from rich.console import Console, RenderableType


def widths(columns: Sequence[Sequence[str]], whole: Collection[int], room: int) -> tuple[list[int], int]:
    """Return the width of each column's text, and the padding at its sides: 1, or 0 where room is short.

    columns: texts of each, the heading among them. whole: places of columns that are not wrapped (numbers).
    room: of texts and padding together, in characters; less than the longest words need is not met.
    """
    from rich.cells import cell_len

    natural = [max(map(cell_len, texts), default=0) for texts in columns]
    words = [[word for text in texts for word in text.split()] for texts in columns]
    least = [
        natural[place] if place in whole else max(map(cell_len, words[place]), default=0)
        for place in range(len(columns))
    ]
    padding = 1 if sum(natural) + 2 * len(columns) <= room else 0
    return _narrowed(natural, least, room - 2 * padding * len(columns)), padding


def _narrowed(natural: Sequence[int], least: Sequence[int], room: int) -> list[int]:
    """Take from the widest column that can give until all fit."""
    found = list(natural)
    while sum(found) > room:
        giving = [place for place, width in enumerate(found) if width > least[place]]
        if not giving:
            break
        found[max(giving, key=found.__getitem__)] -= 1
    return found


def json_ready(value: Any) -> Any:
    """Return a value as in JSON: null for NaN and inf, numpy as plain values, `time` beside `t_ns`."""
    if hasattr(
        value, "tolist"
    ):  # numpy scalars and arrays, without importing numpy for documents that have none
        value = value.tolist()
    if isinstance(value, Mapping):
        return _object(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | bool | int):
        return value
    return [json_ready(item) for item in value] if isinstance(value, Iterable) else str(value)


def _object(value: Mapping[Any, Any]) -> dict[str, Any]:
    ready = {str(key): json_ready(item) for key, item in value.items()}
    if "t_ns" in ready and "time" not in ready:
        ready["time"] = None if ready["t_ns"] is None else iso_time(ready["t_ns"])
    return ready


def print_json(document: Mapping[str, Any]) -> None:
    """Print one JSON document on stdout."""
    out = stdout_text()
    out.write(json.dumps(json_ready(document), allow_nan=False, ensure_ascii=False))
    out.write("\n")


def print_csv(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Print rows as CSV with a header; nothing stands for NULL, numbers keep every digit."""
    writer = csv.writer(stdout_text(), lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([row.get(column) for column in columns] for row in rows)


def print_rows(
    key: str, columns: Sequence[str], rows: Iterable[Mapping[str, Any]], form: str, refused: int
) -> None:
    """Print rows as CSV, or as JSON one a line under a key; the database has no NaN, so none needs replacing.

    refused: how many are not shown because their checksums are wrong; JSON says so, for others a warning
    does.
    """
    if form == "csv":
        print_csv(columns, rows)
        return
    out = stdout_text()
    out.write(f'{{"{key}": [')
    for i, row in enumerate(rows):
        out.write((",\n" if i else "\n") + json.dumps(dict(row), allow_nan=False, ensure_ascii=False))
    out.write(f'], "refused": {refused}}}\n')


class _Shown:
    """A terminal that is written text without orders to it."""

    def write(self, text: str) -> int:
        """Write text."""
        return sys.stdout.write(printable(text))


def stdout_text() -> "SupportsWrite[str]":
    """Return where rows of text go: stdout as it is, but for a terminal."""
    return _Shown() if sys.stdout.isatty() else sys.stdout


def print_table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], *, right: Iterable[str] = ()
) -> None:
    """Print a table for people; columns named in right hold numbers.

    Where a terminal is too narrow, words are wrapped and columns move together; no word is cut.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    numeric = set(right)
    cells = [[printable(cell) for cell in row] for row in rows]
    texts = [[column, *(row[place] for row in cells)] for place, column in enumerate(columns)]
    whole = {place for place, column in enumerate(columns) if column in numeric}
    dividers = len(columns) + 1
    wide, padding = widths(texts, whole, console().width - dividers)
    heading = Text(printable(title)) if title else None
    table = Table(
        title=heading, title_justify="left", title_style="bold", box=SIMPLE_HEAD, padding=(0, padding)
    )
    for column, width in zip(columns, wide, strict=True):
        side: Literal["left", "right"] = "right" if column in numeric else "left"
        table.add_column(Text(column), justify=side, width=width, overflow="fold")
    for row in cells:
        table.add_row(*map(Text, row))
    show(table)


def show(what: "RenderableType") -> None:
    """Print text or anything that rich draws; without markup, and wide where no terminal sets the width."""
    console().print(printable(what) if isinstance(what, str) else what, markup=False, highlight=False)


def console() -> "Console":
    """Return the console of stdout as it is now."""
    from rich.console import Console

    return Console(file=sys.stdout, width=None if sys.stdout.isatty() else PLAIN_WIDTH)


def print_faults(faults: Iterable[Fault], *, as_json: bool = False, causes: Sequence[Fault] = ()) -> None:
    """Print faults on stderr, one a line; as a document on stdout too where JSON was asked for.

    causes: faults that stand on stderr already, and belong before these in the document.
    """
    faults = list(faults)
    for fault in faults:
        sys.stderr.write(f"deltak: error: {printable(' '.join(str(fault).split()))}\n")
    if as_json:
        print_json({"errors": [fault_document(fault) for fault in (*causes, *faults)]})


def fault_of(document: Mapping[str, Any]) -> Fault:
    """Return the fault that stands in JSON."""
    return Fault(*(str(document.get(key) or "") for key in ("path", "message", "advice")))


def fault_document(fault: Fault) -> dict[str, str]:
    """Return a fault as it stands in JSON."""
    return {"path": fault.path, "message": fault.message, "advice": fault.advice}
