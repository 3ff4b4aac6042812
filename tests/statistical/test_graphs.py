"""Which springs and dampers a machine has: found where the file has one too few or too many, nothing added
else."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from agent.errors import AgentError
from tests.figures import figure
from tests.statistical.graphs import CASES, Chosen, chosen


def played(folder: Path, case: str, seeds: range) -> Iterator[Chosen | None]:
    """Choose for the machines of seeds; None where no graph came of it."""
    for seed in seeds:
        try:
            found = chosen(folder, seed, case)
            figure(f"{case} {seed}: {found}")
            yield found
        except AgentError as error:
            figure(f"{case} {seed}: {error}")
            yield None


@pytest.mark.parametrize("case", CASES[1:])
def test_graph_of_two_masses_is_found(case: str, tmp_path: Path) -> None:
    found = chosen(tmp_path, 1, case, masses=2, span_s=25.0)
    assert found.right, found
    assert not found.refused


@pytest.mark.soak
@pytest.mark.timeout(7200)
def test_graph_is_right_for_nine_in_ten_machines_with_one_element_more_or_less(tmp_path: Path) -> None:
    runs = [*played(tmp_path, "one more", range(100, 150)), *played(tmp_path, "one less", range(100, 150))]
    assert sum(run is not None and run.right for run in runs) >= 90


@pytest.mark.soak
@pytest.mark.timeout(7200)
def test_graph_that_is_right_gets_a_false_element_in_at_most_one_in_twenty(tmp_path: Path) -> None:
    runs = list(played(tmp_path, "right", range(200, 400)))
    assert sum(run is None or bool(run.false) for run in runs) <= 10
