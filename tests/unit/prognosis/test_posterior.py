"""The steady law is selected by its odds, and forecasts with the others otherwise."""

import numpy as np
import pytest

from agent.prognosis.filter import State
from agent.prognosis.posterior import Particles, selected

NONE = np.zeros(1)


def member(name: str, evidence: float) -> Particles:
    return Particles(name, (), np.zeros((1, 0)), NONE, State(NONE, NONE, NONE, NONE, NONE), np.log(evidence))


@pytest.mark.parametrize(
    ("odds", "left", "expected"),
    [
        (0.3, 0.5, 0.5),
        (0.6, 0.5, 2**6 / (1 + 2**6)),
        (0.6, 0.2, 2**6 / (1 + 2**6)),  # more of the way gone than left adds nothing
        (0.6, 2 / 3, 2**-18 / (1 + 2**-18)),  # half as much gone as left: to the fourth, to the sixth
        (0.15, 0.5, 2**-6 / (1 + 2**-6)),
    ],
)
def test_steady_law_has_nearly_all_of_the_weight_or_none(odds: float, left: float, expected: float) -> None:
    found = selected([member("constant", odds), member("rate law", 0.75), member("growth", 0.25)], left)
    weights = np.exp([one.log_evidence for one in found])
    assert weights[0] / weights.sum() == pytest.approx(expected)
    assert weights[1:] == pytest.approx([0.75, 0.25])


def test_family_of_one_kind_stays_as_it_is() -> None:
    for alone in ([member("constant", 0.5)], [member("rate law", 0.5), member("growth", 0.2)]):
        assert selected(alone, 0.5) is alone
