"""Golden outputs: what the product makes of known input; `make golden` writes them anew, the diff shows what
moved."""

import pytest

from sim_bus.virtual_time.bench import scored
from tests.golden.cases import Case, cases, shipped
from tests.golden.compare import differences
from tests.golden.text import machine

SHOWN = 12


@pytest.mark.parametrize("case", cases(), ids=str)
def test_output_is_the_golden_one(case: Case) -> None:
    stamp, *committed = case.file.read_text(encoding="utf-8").splitlines()
    found = differences(committed, case.make(), same_machine=stamp == f"# {machine()}")
    words = [
        f"{case.file.name}: {len(found) // 2} lines differ (`make golden` writes them anew):",
        *found[:SHOWN],
    ]
    assert not found, "\n".join(words)


@pytest.mark.parametrize("name", scored())
def test_shipped_scenario_is_met(name: str) -> None:
    _, failures = shipped(name)
    assert not failures


ROW = "row 4999 4999000000 k1 valid none value=100.0 sd=0.5 held=- window_s=0.25"


def test_comparison_on_one_machine_sees_the_last_bit() -> None:
    assert differences([ROW], [ROW], same_machine=True) == []
    assert len(differences([ROW], [ROW.replace("100.0", "100.00000000000001")], same_machine=True)) == 2


@pytest.mark.parametrize(
    ("new", "differs"),
    [
        (ROW.replace("=100.0", "=100.0000004"), False),
        (ROW.replace("=100.0", "=100.0000006"), True),
        (ROW.replace("sd=0.5", "sd=0.5000004"), False),
        (ROW.replace("sd=0.5", "sd=0.500001"), True),
        (ROW.replace("held=-", "held=100.0"), True),
        (ROW.replace("4999 ", "4998 ", 1), True),
        (ROW.replace("valid", "invalid"), True),
    ],
)
def test_comparison_across_machines_allows_a_millionth_of_an_sd(new: str, differs: bool) -> None:
    assert bool(differences([ROW], [new], same_machine=False)) is differs


def test_comparison_shows_a_line_that_is_missing_or_new() -> None:
    assert differences([ROW], [], same_machine=False) == [f"1 - {ROW}", "1 + (nothing)"]
    assert differences([], [ROW], same_machine=False) == ["1 - (nothing)", f"1 + {ROW}"]


def test_comparison_across_machines_counts_the_rows() -> None:
    assert differences(["rows 9 sha256 a"], ["rows 9 sha256 b"], same_machine=False) == []
    assert differences(["rows 9 sha256 a"], ["rows 8 sha256 b"], same_machine=False)


def test_comparison_across_machines_asks_what_was_learnt_when_and_of_what() -> None:
    old, new, later = (f"learnt {t} 1d sha256 {content}" for t, content in ((9, "a"), (9, "b"), (8, "a")))
    assert differences([old], [new], same_machine=False) == []
    assert differences([old], [new], same_machine=True)
    assert differences([old], [later], same_machine=False)


def test_golden_files_are_those_with_a_case() -> None:
    files = {case.file for case in cases()}
    assert set(next(iter(files)).parent.parent.glob("*/*.txt")) == files
