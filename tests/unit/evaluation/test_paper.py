import json
import subprocess
import sys
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from rich.console import Console

from agent.errors import UsageError
from agent.evaluation.paper import cases as paper_cases
from agent.evaluation.paper.figures import _clean
from agent.evaluation.paper.paper import paper, product_estimates, seed_fits, table

NAMES = ("k1", "k2", "B1", "B2")
PUBLISHED = (
    (24.86, 49.74, -0.04, -0.08),
    (-0.12, -0.29, -2.99, -2.99),
    (49.9, -24.91, -0.08, 0.04),
)
ACTUAL = ((25.0, 50.0, 0.0, 0.0), (0.0, 0.0, -3.0, -3.0), (50.0, -25.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    return paper()


def column(rows: list[dict[str, Any]], name: str) -> list[float]:
    assert tuple(row["parameter"] for row in rows) == NAMES
    return [row[name] for row in rows]


def test_paper_as_printed_gives_the_digits_of_one_pass(document: dict[str, Any]) -> None:
    found = column(document["case_1"]["rows"], "as_printed")
    assert [f"{value:.3f}" for value in found] == ["21.618", "35.679", "-1.314", "-1.867"]


def test_paper_by_pass_gives_the_digits_of_each_pass(document: dict[str, Any]) -> None:
    trail = document["case_1"]["by_pass"]
    printed = {
        2: "25.728 53.005 -0.251 -0.937",
        4: "25.149 51.506 0.039 0.119",
        6: "24.965 49.791 -0.002 0.019",
    }
    for number, text in printed.items():
        assert " ".join(f"{trail[number - 1][name]:.3f}" for name in NAMES) == text
    assert " ".join(f"{trail[10][name]:.5f}" for name in NAMES) == "25.00021 50.00239 0.00007 0.00024"


def test_paper_recentred_and_product_reach_the_actual_values_in_all_segments(
    document: dict[str, Any],
) -> None:
    nominal = np.array([25.0, 100.0, 5.0, 5.0])
    for segment, actual, published in zip(document["case_2"]["segments"], ACTUAL, PUBLISHED, strict=True):
        rows = segment["rows"]
        assert column(rows, "actual") == list(actual)
        assert column(rows, "published") == list(published)
        assert np.allclose(column(rows, "recentred"), actual, atol=2e-4)
        theta = nominal + actual
        assert np.all(np.abs(np.subtract(column(rows, "product"), actual)) <= 1e-6 * np.abs(theta))


def test_paper_says_iterations_data_and_conditions(document: dict[str, Any]) -> None:
    case = document["case_1"]
    assert case["iterations_published"] == 17
    assert 1 <= case["iterations"] <= 17
    assert len(case["iterations_by_pass"]) == case["passes"] == 16
    assert document["data"]["as_printed"] == "euler"
    assert document["data"]["product"] == "exact"
    assert case["condition_3"]["holds"]
    assert not case["condition_8"]["holds"]
    assert case["condition_8"]["perturbation_norm"] == pytest.approx(0.0418, abs=5e-5)
    assert len(document["remarks"]) == 4


def test_paper_shows_the_published_matrix_beside_ours_and_that_no_single_pass_gives_it(
    document: dict[str, Any],
) -> None:
    case = document["case_1"]
    of = {name: np.array(matrix) for name, matrix in case["matrix"].items()}
    assert np.allclose(of["published"], of["exact"], atol=1.1e-4)
    assert np.allclose(of["recentred"], of["exact"], atol=1e-7)
    gain = paper_cases.GAIN
    rest = of["as_printed"] - gain @ np.linalg.pinv(gain) @ of["as_printed"]
    assert np.linalg.norm(rest) < 1e-9 * np.linalg.norm(of["as_printed"])
    found = case["range_of_gain"]
    assert found["as_printed"]["outside"] < 1e-9
    assert found["as_printed"]["lower_rows"] >= found["least_lower_rows"] > 0.04
    assert found["published"]["outside"] > 0.04
    assert found["published"]["lower_rows"] < 1e-3
    assert np.allclose(case["observer_poles"]["computed"], case["observer_poles"]["published"], atol=0.01)
    assert case["cost_published"] == 4e-10
    assert case["rows"][0]["percent"]["published"] == pytest.approx(0.56)
    assert "cannot come from the method as printed" in document["remarks"][3]


def test_paper_says_what_error_re_centring_leaves(document: dict[str, Any]) -> None:
    rows = document["case_1"]["rows"]
    left = max(abs(row["recentred"] - row["actual"]) for row in rows if row["unit"] == "N/m")
    assert f"but for {left:.1e} N/m and" in document["remarks"][1]


def test_figure_4_breaks_its_lines_only_where_a_window_holds_a_change() -> None:
    index = np.arange(275, 3001, 25)
    drawn = np.isfinite(_clean(index, np.ones(len(index)), 250))
    assert np.count_nonzero(np.diff(drawn.astype(int)) == -1) == 2
    assert drawn[index == 1250].all()
    assert not drawn[index == 1225].any()


def test_paper_on_its_euler_data_the_exact_model_comes_near_the_published_row(
    document: dict[str, Any],
) -> None:
    found = document["case_1"]["exact_model_on_euler_data"]
    assert found["B1"] == pytest.approx(-0.05, abs=0.01)
    assert found["B2"] == pytest.approx(-0.13, abs=0.02)


def test_paper_with_another_window_and_passes_computes_anew(document: dict[str, Any]) -> None:
    other = paper(window=800, passes=3)
    assert other["window"] == 800
    assert other["case_1"]["passes"] == 3
    for name in ("as_printed", "recentred"):
        old, new = (column(d["case_1"]["rows"], name) for d in (document, other))
        assert all(abs(a - b) > 1e-2 for a, b in zip(old, new, strict=True))
    assert np.allclose(column(other["case_1"]["rows"], "product"), ACTUAL[0], atol=5e-6)


def test_paper_columns_with_k1_one_percent_off_move() -> None:
    changes = (np.array(ACTUAL[0]),), (np.array(ACTUAL[0]) + np.array([0.5, 0.0, 0.0, 0.0]),)
    (printed, *_), (moved, *_) = (seed_fits(c, 250, 16) for c in changes)
    assert abs(moved.trail[0][0] - printed.trail[0][0]) > 0.1
    assert moved.theta[0] - printed.theta[0] == pytest.approx(0.5, abs=1e-3)
    product = [product_estimates(c, 250)[0] for c in changes]
    assert np.allclose(product[1] - product[0], [0.5, 0.0, 0.0, 0.0], atol=1e-6)


def test_paper_data_are_the_printed_first_order_model(document: dict[str, Any]) -> None:
    y = paper_cases.free_decay((np.zeros(4),), "euler")
    assert y.shape == (1000, 2)
    assert np.allclose(y[0], 0.01)
    assert np.allclose(y[1], 0.01 + 1e-3 * 0.01)


@pytest.mark.parametrize("window", [4, 1001, -1])
def test_paper_with_an_impossible_window_says_what_is_possible(window: int) -> None:
    with pytest.raises(UsageError, match=r"--window: .*; take 5 to 1000"):
        paper(window=window)


def test_paper_table_shows_both_tables_counts_and_remarks(document: dict[str, Any]) -> None:
    console = Console(width=140, file=StringIO())
    console.print(table(document))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    for piece in (
        "table 1",
        "combination 3",
        "21.618",
        "24.86",
        "the paper: 17",
        "0.0418",
        "re-centred, 16 passes",
    ):
        assert piece in text
    assert "-0.000000" not in text


def test_paper_plot_draws_a_picture(tmp_path: Path) -> None:
    file = tmp_path / "paper.png"
    paper(passes=1, plot=file)
    picture = imread(file)
    assert picture.shape[0] > 800
    assert picture.std() > 0.05


@pytest.mark.parametrize("name", ["paper.xyz", "paper", "no/such/folder/paper.png"])
def test_paper_plot_that_cannot_be_written_is_refused_at_once(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match=r"--plot: .*no such"):
        paper(plot=tmp_path / name)


def test_paper_command_prints_one_json_document() -> None:
    run = subprocess.run(
        [sys.executable, "-m", "agent", "paper", "--json", "--passes", "2"],
        capture_output=True, text=True, check=True, timeout=100,
    )  # fmt: skip
    found = json.loads(run.stdout)
    assert found["case_1"]["passes"] == 2
    assert column(found["case_1"]["rows"], "as_printed")[0] == pytest.approx(21.6176, abs=1e-3)
    assert not run.stderr
