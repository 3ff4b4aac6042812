"""Widths of a table's columns: where room is short the widest are wrapped first, and no word is cut."""

from collections.abc import Collection, Sequence


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
