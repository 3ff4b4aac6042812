"""What surrounds a rig: the newest reading of each covariate, and which references follow it."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from agent.blocks.covariates.compensation import dependences
from agent.numerics.reference.covariates.dependence import Dependence
from agent.text import ahead, behind, number
from agent.types import Baseline, CovariateMean

LATE_S = 120.0
"""A mean is of a minute that is over, and is committed some time later."""


def surroundings(
    means: Iterable[CovariateMean], standing: Sequence[Baseline], now_ns: int
) -> list[dict[str, Any]]:
    """Return {"covariate", "unit", "value", "t_ns", "age_s", "stale", "compensates", "words"} of each.

    means: the newest of each covariate; t_ns: the end of its period. A covariate that a baseline follows and
    that has no mean is there as well, with None for what is not known.
    """
    newest = {mean.name: mean for mean in means}
    following: dict[str, list[tuple[Baseline, Dependence]]] = {name: [] for name in newest}
    for baseline in standing:
        for one in dependences(baseline):
            following.setdefault(one.name, []).append((baseline, one))
    return [_row(name, newest.get(name), following[name], now_ns) for name in sorted(following)]


def _row(
    name: str, mean: CovariateMean | None, following: Sequence[tuple[Baseline, Dependence]], now_ns: int
) -> dict[str, Any]:
    compensates = [_compensated(baseline, one) for baseline, one in following]
    age_s = _age_s(mean, now_ns)
    return {
        "covariate": name,
        **(_unread(following) if mean is None else _read(mean)),
        "age_s": age_s,
        "stale": _is_stale(age_s, [one.hold_s for _, one in following]),
        "compensates": compensates,
        "words": _words(compensates),
    }


def _read(mean: CovariateMean) -> dict[str, Any]:
    return {"unit": mean.unit, "value": mean.value, "t_ns": _end_ns(mean)}


def _unread(following: Sequence[tuple[Baseline, Dependence]]) -> dict[str, Any]:
    return {"unit": following[0][1].unit, "value": None, "t_ns": None}


def _end_ns(mean: CovariateMean) -> int:
    return mean.t_ns + mean.span_s * 1_000_000_000


def _age_s(mean: CovariateMean | None, now_ns: int) -> float | None:
    return None if mean is None else max(now_ns - _end_ns(mean), 0) / 1e9


def _is_stale(age_s: float | None, holds_s: Sequence[float]) -> bool:
    """Tell whether references hold still: nothing reads a covariate that they follow, or it is old."""
    if not holds_s:
        return False
    return age_s is None or age_s > min(holds_s) + LATE_S


def _compensated(baseline: Baseline, one: Dependence) -> dict[str, Any]:
    share = 100.0 * one.coefficient / abs(baseline.reference) if baseline.reference else None
    change = (
        f"{number(one.coefficient, 2)}{behind(baseline.unit)}" if share is None else f"{number(share, 2)} %"
    )
    late = "at once" if one.shape == "none" else f"{ahead(one.lag_s)} behind"
    return {
        "parameter": baseline.parameter, "baseline_id": baseline.baseline_id, "coefficient": one.coefficient,
        "percent": share, "shape": one.shape, "lag_s": one.lag_s,
        "words": f"{baseline.parameter} by {change} a {one.unit}, {late}",
    }  # fmt: skip


def _words(compensates: Sequence[Mapping[str, Any]]) -> str:
    """Say which references follow a covariate."""
    if not compensates:
        return "no reference follows it"
    return "taken out of " + "; ".join(row["words"] for row in compensates)
