"""A magnetorheological damper whose damping truly switches with its command voltage, some 15 ms apart."""

import csv
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from tests.figures import figure
from tests.peers import data
from tests.replay.records import Replayed, replayed

RATE_HZ = 3004.8
RECORD = "mr_damper/ranran_50_converted.csv"


def dwells(record: Path, least: int) -> list[tuple[int, int, bool]]:
    """Return (first, end, high) of each stretch of at least `least` samples at one of two command levels."""
    with record.open(encoding="utf-8") as file:
        high = np.array([float(row["Y"]) for row in csv.DictReader(file)]) > 1.125
    edges = [0, *(np.flatnonzero(np.diff(high.astype(int))) + 1).tolist(), len(high)]
    pairs = pairwise(edges)
    return [(first, end, bool(high[first])) for first, end in pairs if end - first >= least]


def separated(found: Replayed, record: Path, window: int) -> tuple[int, float]:
    """Return how many dwells hold two windows, and the share whose last B = 1/b lies on its level's side."""
    rows = [row for row in found.of("b") if row["value"] is not None]
    index = np.rint(np.array([row["t_ns"] for row in rows]) * RATE_HZ / 1e9).astype(int)
    values, levels = [], []
    for first, end, level in dwells(record, 2 * window):
        inside = np.flatnonzero((index >= first + window - 1) & (index < end))
        values.append(1.0 / rows[inside[-1]]["value"])
        levels.append(level)
    B, high = np.array(values), np.array(levels)
    border = np.sqrt(np.median(B[high]) * np.median(B[~high]))
    figure(f"B at 0 V {np.median(B[~high]):.0f}, at 2.25 V {np.median(B[high]):.0f} N s/m")
    return len(B), float(np.mean((border < B) == high))


@pytest.mark.parametrize(
    ("window_s", "hop_s", "least", "said"),
    [
        (0.03, 0.01, 0.9, {"changing", "mismatch"}),
        # 45 samples are too few to tell that a damping changes within them
        pytest.param(0.015, 0.015, 0.7, set(), marks=pytest.mark.soak),
    ],
)
def test_mr_damper_dwells_are_told_apart(
    tmp_path: Path, window_s: float, hop_s: float, least: float, said: set[str]
) -> None:
    record = data(RECORD)
    changes = [("window_s = 0.03", f"window_s = {window_s}"), ("hop_s = 0.01 ", f"hop_s = {hop_s} ")]
    found = replayed(
        "mr_damper.toml", record, tmp_path, [(a, b) for a, b in changes if a.strip() != b.strip()]
    )
    count, share = separated(found, record, round(window_s * RATE_HZ))
    figure(f"MR damper, window {1000 * window_s:g} ms: {100 * share:.0f} % of {count} dwells told apart")
    assert share >= least
    reasons = {row["reason"] for row in found.of("b") if row["status"] == "invalid"}
    assert said <= reasons
