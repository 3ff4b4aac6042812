# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound
"""Answers proved to be whole: a row that damage hides is counted, and no older one passes for the newest.

Each row of `hops` has an estimate of every parameter of its run; where an answer has fewer, the others were
lost.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from agent.storage.database.connect import Reader
from agent.storage.database.views import covered
from agent.storage.read.proof import prove_listed

_RANGE = "FROM hops h INDEXED BY hops_by_time WHERE h.run_id = ? AND h.span = ? AND h.t_ns BETWEEN ? AND ?"
_COUNT = f"SELECT count(*) {_RANGE} AND NOT {covered('h.run_id', 'h.t_ns')}"
_OF_RUN = """FROM hops m INDEXED BY hops_by_time WHERE m.run_id = x.seq AND m.span = 0
 ORDER BY m.t_ns DESC, m.seq DESC LIMIT 1"""
_NEWEST = f"""SELECT g.name, x.seq, x.kind = 'live', (SELECT m.seq {_OF_RUN}) AS hop,
 (SELECT m.t_ns {_OF_RUN})
 FROM runs x NOT INDEXED CROSS JOIN rigs g ON g.seq = x.rig_id WHERE hop IS NOT NULL"""
"""From the index alone: the rows themselves may be what is damaged."""
_Newest = tuple[int, int, int]
"""The order of rows: (t_ns, run, hop)."""


def oldest_hop(reader: Reader, stretches: Iterable[tuple[int, int, int, int]]) -> int:
    """Return the least row number of some stretches; stretches: part of a run, shift, first, last (ns)."""
    ranges = ((part, span, first, last) for part, _, first, last in stretches for span in (0, 60, 3600))
    found = (reader.execute(f"SELECT min(h.seq) {_RANGE}", cells).fetchone()[0] for cells in ranges)
    return min((seq for seq in found if seq is not None), default=2**63 - 1)


def prove_count(
    reader: Reader, stretch: tuple[int, int, int, int], rows: Iterable[Mapping[str, Any]], refused: int,
    parameter: str | None,
) -> None:  # fmt: skip
    """Count the rows of full resolution of a stretch that neither came nor were refused.

    Args:
        reader: of the file.
        stretch: part of a run, shift, first and last stamp (ns).
        rows: of v_estimates, those that came of the stretch.
        refused: how many of it were refused.
        parameter: the only one asked for; None for all.
    """
    part, _, first, last = stretch
    known = {
        name
        for (name,) in reader.execute("SELECT parameter FROM series NOT INDEXED WHERE run_id = ?", (part,))
    }
    width = len(known) if parameter is None else int(parameter in known)
    hops = reader.execute(_COUNT, (part, 0, first, last)).fetchone()[0]
    reader.refuse(max(0, width * hops - sum(row["span_s"] == 0 for row in rows) - refused))


def prove_newest(reader: Reader, rows: Iterable[Mapping[str, Any]], rigs: Sequence[str]) -> None:
    """Count parameters of which rows of v_latest show none, or an older one; raises sqlite3.DatabaseError.

    Args:
        reader: of the file, from which nothing but the rows was asked.
        rows: of v_latest.
        rigs: whose rows they are.
    """
    newest = _newest(reader, rigs)
    prove_listed(reader, "hops", min((hop for _, _, hop in newest.values()), default=-(2**63)))
    shown = {(row["rig"], row["parameter"]): row["t_ns"] for row in rows}
    passed_over = sum(shown.get(key) != t_ns for key, (t_ns, _, _) in newest.items())
    reader.refuse(max(0, passed_over - reader.refused))


def _newest(reader: Reader, rigs: Sequence[str]) -> dict[tuple[str, str], _Newest]:
    """Return the newest row of each rig and parameter: of live runs the last stored, of others by stamp."""
    parameters: dict[int, set[str]] = {}
    for run, name in reader.execute("SELECT run_id, parameter FROM series NOT INDEXED"):
        parameters.setdefault(run, set()).add(name)
    live: dict[tuple[str, str], _Newest] = {}
    others: dict[tuple[str, str], _Newest] = {}
    for rig, run, is_live, hop, t_ns in reader.execute(_NEWEST).fetchall():
        found = live if is_live else others
        for key in ((rig, name) for name in parameters.get(run, ()) if rig in rigs):
            best = found.get(key)
            if best is None or (hop > best[2] if is_live else (t_ns, run) > best[:2]):
                found[key] = (t_ns, run, hop)
    return {key: max(one[key] for one in (live, others) if key in one) for key in live | others}
