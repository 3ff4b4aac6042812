"""Steps are alarmed in time and nothing else is; healthy hops are never called changing; a flickering fault
is seen."""

from functools import partial

import numpy as np
import pytest

from tests.statistical.machine import each, say
from tests.statistical.steps import (
    LASTS,
    LIGHT,
    ON_DELAY_S,
    STEPS,
    Raised,
    flicker,
    gives_way,
    healthy,
    latest,
    step,
)

FULL = 25
AT_LAST = 4.0
"""Windows beyond the on-delay within which a spring is alarmed that gave way over more than one."""
UNSEEN = 0.35
"""Most rows that hold a part of a flickering fault and are neither alarmed nor invalid, one run."""


def hold(name: str, found: list[Raised], request: pytest.FixtureRequest) -> None:
    delays = np.array([run.delays for run in found])
    wrong = [w for run in found for w in run.wrong]
    text = ", ".join(sorted(set(wrong))) or "nothing"
    say(
        request,
        f"{name}, {len(found)} runs: alarmed after {np.nanmax(delays):.2f} s at the latest; else {text}",
    )
    assert (delays <= latest()).all()
    assert not wrong


@pytest.mark.parametrize("name", STEPS)
def test_step_is_alarmed_in_time_and_nothing_else_is(name: str, request: pytest.FixtureRequest) -> None:
    hold(name, [step(name, 1)], request)


@pytest.mark.soak
@pytest.mark.parametrize("name", STEPS)
def test_step_is_alarmed_in_time_in_25_runs(name: str, request: pytest.FixtureRequest) -> None:
    hold(name, each(partial(step, name), range(5000, 5000 + FULL)), request)


def hold_giving_way(found: list[Raised], request: pytest.FixtureRequest) -> None:
    delays = np.array([run.delays for run in found]) - LASTS * LIGHT.window_s
    wrong = [w for run in found for w in run.wrong]
    say(
        request,
        f"a spring that gives way within {LASTS} windows, {len(found)} runs: alarmed {np.max(delays):.2f} s "
        f"after it did at the latest; else {', '.join(sorted(set(wrong))) or 'nothing'}",
    )
    assert (delays <= ON_DELAY_S + AT_LAST * LIGHT.window_s).all()
    assert not wrong


def test_spring_that_gives_way_is_alarmed_though_no_window_fits_meanwhile(
    request: pytest.FixtureRequest,
) -> None:
    hold_giving_way([gives_way(seed) for seed in (5, 6)], request)


@pytest.mark.soak
def test_spring_that_gives_way_is_alarmed_in_25_runs(request: pytest.FixtureRequest) -> None:
    hold_giving_way(each(gives_way, range(6000, 6000 + FULL)), request)


def quiet(runs: list[tuple[int, int]], request: pytest.FixtureRequest) -> None:
    hops, called = (sum(part) for part in zip(*runs, strict=True))
    say(request, f"{hops} healthy hops: {called} called changing")
    assert called == 0


def test_healthy_hops_are_not_called_changing(request: pytest.FixtureRequest) -> None:
    quiet([healthy(1, 75)], request)


@pytest.mark.soak
def test_ten_thousand_healthy_hops_are_not_called_changing(request: pytest.FixtureRequest) -> None:
    quiet(each(partial(healthy, windows=100), range(5000, 5006)), request)


def test_flickering_fault_is_alarmed_or_its_rows_are_invalid(request: pytest.FixtureRequest) -> None:
    unseen = flicker(1)
    say(request, f"a flickering fault: {100 * unseen:.0f} % of its rows neither alarmed nor invalid")
    assert unseen <= UNSEEN


def test_flickering_fault_is_not_taken_for_forces() -> None:
    assert np.mean(each(flicker, (8001, 8009))) <= 0.2  # explained by forces its rows were valid: 0.32


@pytest.mark.soak
def test_flickering_fault_is_seen_in_25_runs(request: pytest.FixtureRequest) -> None:
    unseen = each(flicker, range(5000, 5000 + FULL))
    share, most = 100 * np.mean(unseen), 100 * max(unseen)
    say(
        request,
        f"a flickering fault, {FULL} runs: {share:.1f} % of its rows, at most {most:.0f} % of one run's",
    )
    assert np.mean(unseen) <= 0.1
    assert max(unseen) <= UNSEEN
