"""Estimate batches, joined and as rows, by whole columns: a replay writes tens of thousands a second."""

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.storage.database.columns import COLUMN_BITS, numbers_crc
from agent.storage.tables.rows import FitKey, Names, Numbers, Plan
from agent.storage.tuning import NORMAL_DOF, SAME
from agent.types import PER_HOP, BoolArray, EstimateBatch, FloatArray, IntArray, Reason, Status


def join(batches: Sequence[EstimateBatch]) -> EstimateBatch:
    """Return one batch of all rows; the batches must share their header (see `header_of`)."""
    if len(batches) == 1:
        return batches[0]
    parts: dict[str, Any] = {name: np.concatenate([getattr(b, name) for b in batches]) for name in PER_HOP}
    others = tuple(join(same) for same in zip(*(b.others for b in batches), strict=True))
    return replace(batches[0], **parts, others=others)


def header_of(batch: EstimateBatch) -> tuple[object, ...]:
    """Return what is the same for every row of a batch, as something that can be compared."""
    plain = tuple(
        getattr(batch, f.name) for f in fields(batch) if f.name not in (*PER_HOP, "reference", "others")
    )
    return (*plain, len(batch.others), np.asarray(batch.reference, dtype=np.float64).tobytes())


def joined_runs(batches: Sequence[EstimateBatch]) -> Iterator[EstimateBatch]:
    """Yield the batches with consecutive ones of one header joined; their order stays."""
    group: list[EstimateBatch] = []
    for batch in batches:
        if group and header_of(group[0]) != header_of(batch):
            yield join(group)
            group = []
        group.append(batch)
    if group:
        yield join(group)


ROW = np.dtype([
    ("t_ns", "i8"), ("series", "i8"), ("verdict", "i8"), ("value", "f8"), ("sd", "f8"), ("window_s", "f8"),
    ("n_used", "i8"), ("n_missing", "i8"), ("sd_repeat", "f8"),
])  # fmt: skip
"""What minutes are made of; a window of 0 s is none."""
_DIVERGED = (int(Status.INVALID) << 8) | int(Reason.DIVERGED)
_VALID = int(Status.VALID)


def add_estimates(plan: Plan, batch: EstimateBatch, run_id: int, names: Names, numbers: Numbers) -> None:
    """Add a batch's rows to a plan: one in `hops` an instant, one in `estimates` an instant and parameter."""
    if not len(batch):
        return
    first = numbers.take("hops", len(batch))
    hops = np.arange(first, first + len(batch), dtype=np.int64)
    _add_hops(plan, hops, run_id, batch.t_ns.astype(np.int64))
    _add_rows(plan, batch, hops, run_id, names, None)
    room = (1 << COLUMN_BITS) // len(batch.parameters) - 1
    for place, other in enumerate(batch.others[:room], 1):
        _add_rows(plan, other, hops, run_id, names, place)


def _add_rows(
    plan: Plan, batch: EstimateBatch, hops: IntArray, run_id: int, names: Names, place: int | None
) -> None:
    """Add the estimates of the window that was chosen, or those that another one, its place known, has."""
    width = len(batch.parameters)
    first = width * (place or 0)
    seq = ((hops << COLUMN_BITS)[:, None] + np.arange(first, first + width)).ravel()
    value, sd, lower, upper, held, age = (
        _finite(a) for a in (batch.value, batch.sd, batch.lower, batch.upper, batch.held, batch.held_age_s)
    )
    dof = _few_digits(np.minimum(batch.dof, NORMAL_DOF))
    symmetric = _symmetric(value, sd, lower, upper, dof)
    fits = _fits(batch, dof, symmetric, names, chosen=place is None)
    numbered = (seq, _series(batch, run_id, names), fits, _verdicts(batch, value, sd, names))
    ends = (np.where(symmetric, np.nan, lower), np.where(symmetric, np.nan, upper))
    bare = (value, sd, *ends, held, age, repeat_cells(sd, batch.sd_repeat))
    columns = (*numbered, *(a.ravel() for a in bare))
    if place is None:
        plan.estimates.append((run_id, _as_stored(batch, columns)))
    else:
        reported = np.isfinite(value.ravel())
        columns = tuple(column[reported] for column in columns)
    plan.add(
        "estimates", *zip(*(c.tolist() for c in (*columns, numbers_crc("estimates", columns))), strict=True)
    )


def _as_stored(batch: EstimateBatch, columns: Sequence[NDArray[Any]]) -> NDArray[np.void]:
    """Return rows as they are read back for minutes; columns: what is stored in `estimates` of them."""
    _, series, _, verdict, value, sd, *_, repeat = columns
    rows = np.empty(len(value), ROW)
    rows["series"], rows["verdict"], rows["value"], rows["sd"] = series, verdict, value, sd
    rows["sd_repeat"] = np.where(np.isnan(repeat), sd, sd * repeat * 1e-4)
    rows["window_s"] = np.where(batch.window_s >= 0, batch.window_s, 0.0).ravel()
    for name, each in (("t_ns", batch.t_ns), ("n_used", batch.n_used), ("n_missing", batch.n_missing)):
        rows[name] = np.repeat(each, len(batch.parameters))
    return rows


def repeat_cells(sd: FloatArray, sd_repeat: FloatArray) -> FloatArray:
    """Return sd_repeat in ten-thousandths of sd; NaN where they are the same, or one is none.

    Whole ones from a hundredth of sd on, which SQLite keeps in two bytes: a rig-year grows by 5 %, with eight
    by 15 %.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        share = 1e4 * sd_repeat / sd
        rounded = np.where(share >= 100.0, np.rint(share), share)
    return np.where(np.isfinite(rounded) & (rounded != 1e4), rounded, np.nan)


def _add_hops(plan: Plan, hops: IntArray, run_id: int, t_ns: IntArray) -> None:
    run = np.full_like(hops, run_id)
    span = np.zeros_like(hops)
    columns = (hops, run, span, t_ns)
    plan.add("hops", *zip(*(c.tolist() for c in (*columns, numbers_crc("hops", columns))), strict=True))


def _finite(numbers: FloatArray) -> FloatArray:
    """Return a copy in which everything that is not a number is NaN, which SQLite stores as NULL."""
    return np.where(np.isfinite(numbers), numbers, np.nan)


def _few_digits(dof: FloatArray) -> FloatArray:
    """Return whole degrees of freedom as they are, others (N,) to two digits.

    White noise leaves whole ones, the same over the years. Coloured noise leaves a new fraction each window;
    a row in `fits` for each would outgrow the estimates. Intervals are not made of what is lost: they stand
    in the row itself.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        step = 10.0 ** (np.floor(np.log10(dof)) - 1)
        return np.where((dof == np.rint(dof)) | ~(dof > 0), dof, np.rint(dof / step) * step)


def _symmetric(
    value: FloatArray, sd: FloatArray, lower: FloatArray, upper: FloatArray, dof: FloatArray
) -> BoolArray:
    """Tell where lower and upper follow from value, sd and Student's t; (N, q)."""
    from scipy.special import stdtrit

    half = np.asarray(stdtrit(np.where(dof > 0, dof, np.nan), 0.975))[:, None] * sd
    slack = SAME * sd
    follows = (np.abs(value - half - lower) <= slack) & (np.abs(value + half - upper) <= slack)
    nothing = np.isnan(value) & np.isnan(lower) & np.isnan(upper)
    answer: BoolArray = follows | nothing
    return answer


def _series(batch: EstimateBatch, run_id: int, names: Names) -> IntArray:
    references = [None if not np.isfinite(r) else float(r) for r in batch.reference]
    learnt = batch.baseline_id or (None,) * len(references)
    described = zip(batch.parameters, batch.units, references, learnt, strict=True)
    ids = [names.series((run_id, p, unit, batch.method, ref, number)) for p, unit, ref, number in described]
    return np.tile(np.array(ids, dtype=np.int64), len(batch))


def _verdicts(batch: EstimateBatch, value: FloatArray, sd: FloatArray, names: Names) -> IntArray:
    """Return status and reason as one number; a valid row without a number is stored as diverged."""
    codes = (batch.status.astype(np.int64) << 8) | batch.reason.astype(np.int64)
    lie = (batch.status == _VALID) & (np.isnan(value) | np.isnan(sd))
    codes = np.where(lie, _DIVERGED, codes).ravel()
    names.verdicts(set(np.unique(codes).tolist()))
    return codes


def _fits(
    batch: EstimateBatch, dof: FloatArray, symmetric: BoolArray, names: Names, *, chosen: bool
) -> IntArray:
    """Return (N q,) numbers of fits; looked up only where something changes from one hop to the next."""
    out = np.empty(batch.value.shape, dtype=np.int64)
    shared = (batch.n_used, batch.n_missing, dof)
    for column in range(len(batch.parameters)):
        keys = np.column_stack((batch.window_s[:, column], *shared, symmetric[:, column])).astype(np.float64)
        keys = np.where(np.isnan(keys), -1.0, keys)
        starts = np.flatnonzero(np.r_[True, (keys[1:] != keys[:-1]).any(axis=1)])
        ids = [names.fit(_fit_key(keys[start].tolist(), chosen=chosen)) for start in starts]
        out[:, column] = np.repeat(ids, np.diff(np.r_[starts, len(keys)]))
    return out.ravel()


def _fit_key(cells: list[float], *, chosen: bool) -> FitKey:
    window, used, missing, dof, symmetric = cells
    plain_dof, known = dof if dof > 0 else None, window if window >= 0 else None
    return (known, max(0, int(used)), max(0, int(missing)), plain_dof, bool(symmetric), int(chosen))
