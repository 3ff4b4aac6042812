"""What like machines did from a level onward: their spread, and whether a machine is one of them."""

import numpy as np
import pytest

from agent.prognosis.traces import Alike, Trace, alike, trace

LIMIT = -0.4


def machines(rng: np.random.Generator, count: int) -> list[Trace]:
    """Traces of falls that bend, whose lives differ by a tenth."""
    return [course(100.0 * float(np.exp(0.1 * rng.standard_normal()))) for _ in range(count)]


def course(life: float, until: float = 1.0) -> Trace:
    share = np.linspace(0.0, until, 120)
    return trace(life * share, LIMIT * share**2)


def held_against(traces: list[Trace], until: float, shape: float, rng: np.random.Generator) -> Alike | None:
    """What they say of a machine of their mean life, seen up to a share of it, whose fall has a shape."""
    share = np.linspace(0.0, until, 80)
    smooth = LIMIT * share**shape
    return alike(traces, LIMIT, 100.0 * share, smooth, np.full(4, smooth[-1]), 4000, rng)


def test_what_remains_spreads_as_it_did_for_like_machines(rng: np.random.Generator) -> None:
    found = held_against(machines(rng, 20), 0.5, 2.0, rng)
    assert found is not None
    assert found.share > 0.95
    assert float(np.median(found.remains)) == pytest.approx(50.0, rel=0.1)
    low, high = np.quantile(found.remains, [0.1, 0.9])
    assert high / low < 1.5  # who was a tenth slower until now has a tenth more left


def test_one_machine_leaves_open_how_much_others_differ(rng: np.random.Generator) -> None:
    few, many = (held_against(machines(rng, count), 0.5, 2.0, rng) for count in (1, 20))
    assert few is not None
    assert many is not None
    assert np.ptp(np.quantile(few.remains, [0.1, 0.9])) > 2.0 * np.ptp(np.quantile(many.remains, [0.1, 0.9]))


def test_machine_of_another_course_is_none_of_them(rng: np.random.Generator) -> None:
    found = held_against(machines(rng, 12), 0.8, 0.7, rng)
    assert found is not None
    assert found.share < 0.02


def test_traces_that_end_far_from_the_limit_say_nothing_of_it(rng: np.random.Generator) -> None:
    assert held_against([course(100.0, 0.7)], 0.5, 2.0, rng) is None


def test_trace_that_ends_just_before_the_limit_is_carried_on(rng: np.random.Generator) -> None:
    whole, short = (held_against([course(100.0, until)], 0.5, 2.0, rng) for until in (1.0, 0.985))
    assert whole is not None
    assert short is not None
    assert float(np.median(short.remains)) == pytest.approx(float(np.median(whole.remains)), rel=0.05)
