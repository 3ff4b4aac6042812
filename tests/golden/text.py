"""A run as text: every n-th row of estimates, all other records, and the ledger, to the last bit."""

import hashlib
import platform
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import scipy

from agent.records import ClockRecord, Health, HealthEvent, LearntRecord, Record
from agent.types import AlarmTransition, EstimateBatch, Reason, Status, Verdict

ARRAYS = (
    "index", "t_ns", "value", "sd", "lower", "upper", "status", "reason", "held", "held_age_s", "window_s",
    "n_used",
    "n_missing", "dof", "reference",
)  # fmt: skip


def machine() -> str:
    """Name what decides the last bits: numpy, scipy, the linear algebra that numpy calls, and the processor's
    kind."""
    shown: Mapping[str, Any] = np.show_config(mode="dicts")  # type: ignore[call-overload]
    blas = shown["Build Dependencies"]["blas"]
    vectors = ",".join(shown["SIMD Extensions"]["found"])
    libraries = f"numpy {np.__version__}, scipy {scipy.__version__}, {blas['name']} {blas['version']}"
    return f"{libraries}, {platform.machine()} {vectors}"


def lines(records: Iterable[Record], ledger: Sequence[Health], every: int) -> list[str]:
    """Return a run as lines: one row of estimates in `every`, all that is no row, what all rows add up to."""
    digest, count, found = hashlib.sha256(), 0, []
    for record in records:
        if isinstance(record, EstimateBatch):
            shown = [at for at in range(len(record)) if (count + at) % every == every - 1]
            found += [line for at in shown for line in _row(record, at)]
            count += len(record)
            _digest(digest, record)
        elif not isinstance(record, Health):
            found.append(_other(record))
    found += [_ledger(health) for health in ledger]
    return [*found, f"rows {count} sha256 {digest.hexdigest()}"]


def _digest(digest: "hashlib._Hash", batch: EstimateBatch) -> None:
    """Add every number of a batch, those of all windows included."""
    for one in (batch, *batch.others):
        for name in ARRAYS:
            # a NaN has many patterns of bits and one meaning
            array = np.asarray(getattr(one, name))
            digest.update(np.where(array == array, array, np.nan).astype(array.dtype).tobytes())  # noqa: PLR0124


def _row(batch: EstimateBatch, at: int) -> list[str]:
    counts = f"used={int(batch.n_used[at])} missing={int(batch.n_missing[at])} dof={_number(batch.dof[at])}"
    return [
        f"row {int(batch.index[at])} {int(batch.t_ns[at])} {name} {_code(Status, batch.status[at, i])}"
        f" {_code(Reason, batch.reason[at, i])} value={_number(batch.value[at, i])}"
        f" sd={_number(batch.sd[at, i])}"
        f" held={_number(batch.held[at, i])} window_s={_number(batch.window_s[at, i])}"
        + (f" {counts}" if i == 0 else "")
        for i, name in enumerate(batch.parameters)
    ]


def _other(record: Record) -> str:
    if isinstance(record, AlarmTransition):
        figures = [(key, getattr(record, key)) for key in ("delta", "sd", "limit_value", "probability")]
        numbers = " ".join(f"{key}={_number(value)}" for key, value in figures if value is not None)
        step = f"{record.from_state}>{record.to_state} {record.cause}"
        return f"alarm {record.t_ns} {record.kind} {record.parameter} {step} {numbers} | {record.message}"
    if isinstance(record, HealthEvent):
        return f"event {record.t_ns} {record.source} {record.cause} | {record.message}"
    if isinstance(record, ClockRecord):
        return f"clock {record.t_ns} from {record.index} offset_ns={record.offset_ns}"
    if isinstance(record, Verdict):
        figures = (
            f"size={_number(record.size)} sd={_number(record.sd)} probability={_number(record.probability)}"
        )
        return f"verdict {record.t_ns} {record.hypothesis} {figures} {record.unit}"
    assert isinstance(record, LearntRecord)
    content = hashlib.sha256(record.learnt.content.encode()).hexdigest()
    return f"learnt {record.t_ns} {record.learnt.key} sha256 {content}"


def _ledger(health: Health) -> str:
    kinds = (("rejected", health.rejected), ("dropped", health.dropped), ("faults", health.faults))
    counted = [f"{kind}[{reason}]={n}" for kind, counts in kinds for reason, n in sorted(counts.items()) if n]
    sums = f"received={health.received} used={health.used} gaps={health.gaps}"
    return " ".join(["ledger", health.source, sums, *counted])


def _code(kind: type[Status] | type[Reason], code: int) -> str:
    return kind(int(code)).name.lower()


def _number(value: float) -> str:
    """Return a number so that reading it gives every bit again."""
    number = float(value)
    return "-" if np.isnan(number) else repr(number)
