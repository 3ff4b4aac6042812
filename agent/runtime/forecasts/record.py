"""How good the forecasts were that are stored: what stands beside a new one."""

from collections.abc import Mapping, Sequence
from typing import Any

from agent.prognosis.scores import alpha_lambda

Row = Mapping[str, Any]


def record_of(rows: Sequence[Row]) -> dict[str, Any]:
    """Return what became of stored forecasts, rows of v_forecast, oldest first.

    made: those with a band whose time has come; held: of these, whose passage came in it; crps: mean, s;
    waiting: those whose time is to come; bias_s: mean of P50 less the passage; alpha_lambda: share of medians
    within a fifth of what remained; horizon_s: what remained at the newest passage when medians had become so
    good to stay.
    """
    scored = [row for row in rows if row["scored_ns"] is not None]
    banded = [row for row in scored if row["held"] is not None]
    crps = [row["crps"] for row in banded if row["crps"] is not None]
    reached = [row for row in banded if row["crossed_ns"] is not None and row["p50_ns"] is not None]
    late = [(row["p50_ns"] - row["crossed_ns"]) / 1e9 for row in reached]
    return {
        "made": len(banded), "held": sum(row["held"] for row in banded), "crps": _mean(crps),
        "waiting": len(rows) - len(scored), "bias_s": _mean(late),
        "alpha_lambda": _mean([float(_is_good(row)) for row in reached]), "horizon_s": _horizon_s(reached),
    }  # fmt: skip


def _mean(numbers: Sequence[float]) -> float | None:
    return sum(numbers) / len(numbers) if numbers else None


def _is_good(row: Row) -> bool:
    made = row["made_at_ns"]
    return alpha_lambda(float(row["p50_ns"] - made), float(row["crossed_ns"] - made))


def _horizon_s(reached: Sequence[Row]) -> float | None:
    """Return the newest passage's prognostic horizon (Saxena et al. 2010); None if no median became good."""
    newest = max((row["crossed_ns"] for row in reached), default=None)
    good = None
    for row in reversed([row for row in reached if row["crossed_ns"] == newest]):
        if not _is_good(row):
            break
        good = (row["crossed_ns"] - row["made_at_ns"]) / 1e9
    return good
