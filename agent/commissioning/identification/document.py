"""The document of an identification: values, doubts, refusals, and the changes that `--write` makes."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from agent.blocks.rig_model import SENSOR_KINDS
from agent.commissioning.identification.doubts import refusals, why_unknown
from agent.commissioning.identification.found import Found
from agent.config import RigConfig


def document_of(rig: RigConfig, found: Found) -> dict[str, Any]:
    """Return the document of CONTRACT section 8, but for what only the command knows."""
    errors = list(refusals(rig, found))
    rows = {p.name: _row(found, i) for i, p in enumerate(found.rig.parameters)}
    shares = {c.name: 100.0 * s for c, s in zip(rig.outputs, found.seen.share.tolist(), strict=True)}
    return {
        "rig": rig.rig.name, "ok": not errors, "parameters": rows,
        "unexplained_percent": max(shares.values()),
        "unexplained": shares, "graph": [], "windows": found.windows,
        "window_s": found.window / rig.rig.sample_rate_hz, "scatter": found.pooled.scatter,
        "changes": _changes(rig, rows), "written": None,
        "errors": [{"path": e.path, "message": e.message, "advice": e.advice} for e in errors],
    }  # fmt: skip


def _row(found: Found, i: int) -> dict[str, Any]:
    value, sd = float(found.pooled.theta[i]), float(found.pooled.sd[i])
    why = why_unknown(found, i)
    return {
        "value": value, "sd": sd, "sd_repeat": float(found.pooled.sd_repeat[i]), "lower": value - 1.96 * sd,
        "upper": value + 1.96 * sd, "unit": found.rig.parameters[i].unit, "identifiable": why is None,
        "why": why,
        "other": _other(found, i),
    }  # fmt: skip


def _other(found: Found, i: int) -> float | None:
    """Return the parameter's value in another solution that explains as much; None where there is none."""
    rival = found.rival_in(i)
    return None if rival is None else float(rival.theta[i])


def _changes(rig: RigConfig, rows: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return what --write puts into the file: values of elements, masses and entries that are known."""
    known = rig.parameters
    changes = []
    for name, row in rows.items():
        before, kind = known[name].nominal, known[name].kind
        if kind not in SENSOR_KINDS and row["identifiable"]:
            old = None if np.isnan(before) else before
            new = f"{row['value']:.10g}" if kind == "linear" else f"{max(row['value'], 0.0):.6g}"
            changes.append({"parameter": name, "from": old, "to": float(new)})
    return changes
