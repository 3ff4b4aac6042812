"""What surrounds a rig: the newest reading of each covariate, and which references follow it."""

from collections.abc import Iterable, Mapping, Sequence
from math import inf
from typing import Any

from agent.blocks.covariates.compensation import dependences
from agent.cli.tuning import LATE_MEAN_S
from agent.records import Baseline, CovariateMean
from agent.reference.covariates.dependence import Dependence
from agent.text import ahead, behind, number


def covariates_now(
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
    unit = following[0][1].unit if mean is None else mean.unit
    t_ns, value, age_s = _read(mean, now_ns)
    holds_s = min((one.hold_s for _, one in following), default=inf)
    compensates = [_compensated(baseline, one) for baseline, one in following]
    return {
        "covariate": name,
        "unit": unit,
        "value": value,
        "t_ns": t_ns,
        "age_s": age_s,
        "stale": (inf if age_s is None else age_s) > holds_s + LATE_MEAN_S,
        "compensates": compensates,
        "words": _words(compensates),
    }


def _read(mean: CovariateMean | None, now_ns: int) -> tuple[int | None, float | None, float | None]:
    """Return the end of a mean's period, the mean and its age, s; None of one that is not there."""
    if mean is None:
        return None, None, None
    t_ns = mean.t_ns + mean.span_s * 1_000_000_000
    return t_ns, mean.value, max(now_ns - t_ns, 0) / 1e9


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
