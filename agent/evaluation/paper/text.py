"""What a terminal shows of `deltak paper`."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from agent.evaluation.paper import cases
from agent.numerics.model.statespace import discretise
from agent.numerics.paper.seed_window import SeedFit
from agent.types import FloatArray

if TYPE_CHECKING:
    from rich.console import RenderableType


def matrices(change: FloatArray, fit: SeedFit, recentred: FloatArray) -> dict[str, Any]:
    """Return ΔA of case 1: exact, as published, of one pass, and of re-centred passes with imposed structure.

    Args:
        change: (4,) the actual one.
        fit: the passes; the first of them is the method as printed.
        recentred: (4,) the change that they end at.
    """
    nominal = _transition(np.zeros(4))
    of = {
        "exact": _transition(change) - nominal,
        "published": cases.MATRIX,
        "as_printed": fit.descents[0].M,
        "recentred": _transition(recentred) - nominal,
    }
    return {name: matrix.tolist() for name, matrix in of.items()}


def in_range(matrix: FloatArray) -> dict[str, float]:
    """Say how a matrix lies to the range of K_e, in which every one-pass ΔA is, its regressand being K_e ε.

    outside: share of its norm beyond the range. lower_rows: its last two rows over its first two.
    """
    gain = cases.GAIN
    rest = matrix - gain @ np.linalg.lstsq(gain, matrix, rcond=None)[0]
    return {
        "outside": float(np.linalg.norm(rest) / np.linalg.norm(matrix)),
        "lower_rows": float(np.linalg.norm(matrix[2:]) / np.linalg.norm(matrix[:2])),
    }


def least_lower_rows() -> float:
    """Return the least that the last two rows of a matrix in the range of K_e can be, of its first two."""
    return float(np.linalg.svd(cases.GAIN[2:] @ np.linalg.inv(cases.GAIN[:2]), compute_uv=False)[-1])


def observer_poles() -> list[float]:
    """Return where the printed K_e puts the observer's poles, 1/s, by the first-order model: z = 1 + s T."""
    model = discretise(cases.rig().continuous(cases.NOMINAL), cases.PERIOD_S, "euler").model
    z = np.linalg.eigvals(model.A - cases.GAIN @ model.C)
    return sorted(((z.real - 1.0) / cases.PERIOD_S).tolist())


def _transition(change: FloatArray) -> FloatArray:
    return discretise(cases.rig().continuous(cases.NOMINAL + change), cases.PERIOD_S, "euler").model.A


def table(document: Mapping[str, Any]) -> "RenderableType":
    """Return what a terminal shows of a document."""
    from rich.console import Group
    from rich.text import Text

    case = document["case_1"]
    window, passes = document["window"], case["passes"]
    tables = [_segment_table("table 1: case 1, constant changes", case["rows"], passes)]
    tables += [
        _segment_table(f"table 3: case 2, combination {number}", segment["rows"], passes)
        for number, segment in enumerate(document["case_2"]["segments"], start=1)
    ]
    counts = f"by pass {', '.join(str(count) for count in case['iterations_by_pass'])}"
    lines = [
        f"window of {window} samples; as printed and re-centred on Euler data, product on exact data",
        (
            f"iterations of descent: {case['iterations']} as printed "
            f"(the paper: {case['iterations_published']}), {counts}"
        ),
        _end_line(case),
        _poles_line(case["observer_poles"]),
        _margin_line(case),
        *document["remarks"],
    ]
    return Group(*tables, _matrix_table(case["matrix"]), *(Text(line) for line in lines))


def _matrix_table(of: dict[str, list[list[float]]]) -> "RenderableType":
    from rich.table import Table

    drawn = Table(title="the matrix of case 1", title_justify="left", title_style="bold")
    drawn.add_column("row")
    names = {"published": "published", "as_printed": "as printed", "recentred": "re-centred"}
    for title in names.values():
        drawn.add_column(title, justify="right", no_wrap=True)
    for i in range(len(of["published"])):
        drawn.add_row(str(i + 1), *("  ".join(f"{cell:9.2e}" for cell in of[name][i]) for name in names))
    return drawn


def _end_line(case: dict[str, Any]) -> str:
    cost = f"cost at its end: {case['cost']:.3g} (the paper: {case['cost_published']:.0e})"
    return f"{cost}, last step of Z {case['step']:.0e} (the paper: {case['step_published']:.0e})"


def _poles_line(poles: dict[str, list[float]]) -> str:
    computed, published = (
        ", ".join(f"{pole:.4g}" for pole in poles[name]) for name in ("computed", "published")
    )
    return f"observer poles of the printed gain: {computed} 1/s (the paper: {published})"


def _segment_table(title: str, rows: list[dict[str, Any]], passes: int) -> "RenderableType":
    from rich.table import Table

    drawn = Table(title=title, title_justify="left", title_style="bold")
    drawn.add_column("change of")
    for column in ("actual", "published", "as printed", f"re-centred, {passes} passes", "product"):
        drawn.add_column(column, justify="right", no_wrap=True)
    drawn.add_column("unit")
    drawn.add_column("off by, %: published, as printed", justify="right", no_wrap=True)
    for row in rows:
        figures = (row["recentred"], row["product"])
        drawn.add_row(
            row["parameter"], f"{row['actual']:g}", f"{row['published']:g}", _figure(row["as_printed"], 3),
            *(_figure(figure, 6) for figure in figures), row["unit"], _errors(row["percent"]),
        )  # fmt: skip
    return drawn


def _errors(percent: dict[str, float | None]) -> str:
    shown = [percent[name] for name in ("published", "as_printed")]
    return ", ".join("–" if error is None else f"{error:.2f}" for error in shown) if any(shown) else ""


def _figure(value: float | None, places: int) -> str:
    # + 0.0 turns a rounded -0.000 into 0.000
    return "not valid" if value is None else f"{round(value, places) + 0.0:.{places}f}"


def _margin_line(case: dict[str, Any]) -> str:
    three, eight = case["condition_3"], case["condition_8"]
    verdict = "covers it" if eight["holds"] else "sufficient but not necessary, says nothing of it"
    return (
        f"condition (3) {'holds' if three['holds'] else 'fails'} in case 1; "
        "condition (8) bears perturbations below "
        f"{eight['delta']:.5g}, case 1 is one of {eight['perturbation_norm']:.3g}: (8) {verdict}"
    )
