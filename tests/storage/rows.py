"""Records for the storage tests: estimates that look like a rig's, and the steps of an alarm's life."""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import stdtrit

from agent.records import Health, RunInfo
from agent.storage.database.connect import connect_reader
from agent.types import AlarmTransition, EstimateBatch, Reason, Status, Verdict

START = 1_767_225_600_000_000_000  # 2026-01-01T00:00:00Z
HOP = 50_000_000
PARAMETERS = ("k1", "k2", "B1", "B2")


def run_info(rig: str = "press-7", kind: Any = "live", started_ns: int = START) -> RunInfo:
    return RunInfo(rig, kind, started_ns, "0.1.0", "ab" * 32, None, "boot-1")


def batch(
    hops: int,
    *,
    first: int = 0,
    start: int = START,
    hop_ns: int = HOP,
    rig: str = "press-7",
    parameters: tuple[str, ...] = PARAMETERS,
    **changes: Any,
) -> EstimateBatch:
    """Valid estimates at consecutive hops; values are a function of the hop's number."""
    width = len(parameters)
    index = np.arange(first, first + hops)
    rng = np.random.default_rng(first)
    value = 25.0 + np.arange(width) + 0.1 * np.sin(index)[:, None]
    sd = rng.uniform(0.1, 0.2, (hops, width))
    dof = np.full(hops, 488.0)
    half = np.asarray(stdtrit(dof, 0.975))[:, None] * sd
    nothing = np.full((hops, width), np.nan)
    fields: dict[str, Any] = {
        "rig": rig, "method": "window-ml", "parameters": parameters, "units": ("N/m",) * width,
        "reference": 25.0 + np.arange(width), "baseline_id": None, "index": 250 + 50 * index,
        "t_ns": start + hop_ns * index, "value": value, "sd": sd, "lower": value - half,
        "upper": value + half,
        "sd_repeat": changes.get("sd", sd) * rng.uniform(0.5, 1.0, (hops, width)),
        "status": np.full((hops, width), Status.VALID, np.uint8), "reason": np.zeros((hops, width), np.uint8),
        "held": nothing, "held_age_s": nothing.copy(), "window_s": np.full((hops, width), 0.25),
        "n_used": np.full(hops, 250), "n_missing": np.zeros(hops, int), "dof": dof,
    }  # fmt: skip
    return EstimateBatch(**(fields | changes))


def warming(hops: int, **changes: Any) -> EstimateBatch:
    """Rows before the first full window."""
    plain = batch(hops, **changes)
    nothing = np.full(plain.value.shape, np.nan)
    return batch(
        hops, **changes, value=nothing, sd=nothing, lower=nothing, upper=nothing, dof=np.full(hops, np.nan),
        status=np.full(plain.value.shape, Status.WARMING, np.uint8),
        reason=np.full(plain.value.shape, Reason.NONE, np.uint8),
    )  # fmt: skip


def step(old: Any, new: Any, t_ns: int = START, **changes: Any) -> AlarmTransition:
    fields: dict[str, Any] = {
        "rig": "press-7", "kind": "level", "parameter": "k1", "priority": "high", "t_ns": t_ns,
        "from_state": old,
        "to_state": new, "cause": "limit", "message": "k1 fell by 16 N/m", "delta": -16.0, "sd": 0.2,
        "limit_value": 15.0, "probability": 0.99,
    }  # fmt: skip
    return AlarmTransition(**(fields | changes))


def verdict(t_ns: int = START, **changes: Any) -> Verdict:
    fields: dict[str, Any] = {
        "rig": "press-7", "t_ns": t_ns, "hypothesis": "m1", "size": 4.25, "sd": 0.5, "unit": "%",
        "probability": 0.97,
    }  # fmt: skip
    return Verdict(**(fields | changes))


def ledger(t_ns: int = START, **changes: Any) -> Health:
    fields: dict[str, Any] = {
        "rig": "press-7", "source": "can", "t_ns": t_ns, "received": 1000, "used": 990,
        "rejected": {"crc": 3, "duplicate": 2}, "dropped": {"queue full": 5}, "gaps": 1, "lag_s": 0.01,
    }  # fmt: skip
    return Health(**(fields | changes))


def select(path: Path, query: str, *values: object) -> list[tuple[Any, ...]]:
    connection = connect_reader(path)
    try:
        return connection.execute(query, values).fetchall()
    finally:
        connection.close()
