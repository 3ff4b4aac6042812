"""What a terminal shows of `deltak paper`."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import RenderableType


def table(document: dict[str, Any]) -> "RenderableType":
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
        f"iterations of descent: {case['iterations']} as printed (the paper: {case['iterations_published']}), {counts}",
        _margin_line(case),
        *document["remarks"],
    ]
    return Group(*tables, *(Text(line) for line in lines))


def _segment_table(title: str, rows: list[dict[str, Any]], passes: int) -> "RenderableType":
    from rich.table import Table

    drawn = Table(title=title, title_justify="left", title_style="bold")
    drawn.add_column("change of")
    for column in ("actual", "published", "as printed", f"re-centred, {passes} passes", "product"):
        drawn.add_column(column, justify="right", no_wrap=True)
    drawn.add_column("unit")
    for row in rows:
        figures = (row["recentred"], row["product"])
        drawn.add_row(
            row["parameter"], f"{row['actual']:g}", f"{row['published']:g}", _figure(row["as_printed"], 3),
            *(_figure(figure, 6) for figure in figures), row["unit"],
        )  # fmt: skip
    return drawn


def _figure(value: float | None, places: int) -> str:
    # + 0.0 turns a rounded -0.000 into 0.000
    return "not valid" if value is None else f"{round(value, places) + 0.0:.{places}f}"


def _margin_line(case: dict[str, Any]) -> str:
    three, eight = case["condition_3"], case["condition_8"]
    verdict = "covers it" if eight["holds"] else "sufficient but not necessary, says nothing of it"
    return (
        f"condition (3) {'holds' if three['holds'] else 'fails'} in case 1; condition (8) bears perturbations below "
        f"{eight['delta']:.5g}, case 1 is one of {eight['perturbation_norm']:.3g}: (8) {verdict}"
    )
