"""What a configuration leaves open of commanded inputs, and what is said of them."""

import pytest

from agent.blocks.constants_watch import ConstantsWatch
from agent.blocks.statistical_rig import statistical_rig
from agent.numerics.inference.verdicts import Belief
from agent.records import HealthEvent
from tests.statistical.chains import DRIVEN, TWO

DENIED = '[estimator.observer]\ngain = "kalman"\nprocess_sd = 0'


def delays(**said: object) -> list[tuple[int, float]]:
    """Number and data sheet of the delays of commands to two masses that show their places."""
    constants = statistical_rig(TWO.configuration(hold="zero", **said)).constants
    return [(c.number, c.sheet) for c in constants if c.kind == "delay"]


def messages(beliefs: tuple[Belief, ...], commanded: bool = True) -> list[str]:
    watch = ConstantsWatch("rig", 1e-3, 250, frozenset({"x1"}), commanded)
    found = watch.step([(0, beliefs)], {0: 0}).values
    return [record.message for record in found if isinstance(record, HealthEvent)]


def late(size: float) -> Belief:
    return Belief("delay", False, "delay", 0.99, size, 0.01)


def test_commands_have_a_delay_of_a_quarter_of_a_sample_or_as_stated() -> None:
    assert delays() == [(0, 0.25)]
    assert delays(delay_sd_s=0.001) == [(0, pytest.approx(1.0))]
    assert delays(delay_sd_s=0.0) == []


def test_commands_have_none_where_forces_are_denied_unless_it_is_stated() -> None:
    assert delays(observer=DENIED) == []
    assert delays(observer=DENIED, delay_sd_s=0.001) == [(0, pytest.approx(1.0))]


def test_outputs_that_see_a_command_directly_may_be_read_before_it() -> None:
    constants = statistical_rig(DRIVEN.configuration(hold="zero")).constants
    assert [c.number for c in constants if c.kind == "delay"] == [0, 1]


@pytest.mark.parametrize(
    ("size", "commanded", "advice"),
    [
        (0.5, True, "the outputs"),
        (-0.5, True, 'hold = "first"'),
        (0.5, False, 'hold = "zero"'),
    ],
)
def test_a_delay_is_said_with_what_mends_it(size: float, commanded: bool, advice: str) -> None:
    (message,) = messages((late(size),), commanded)
    assert f"the inputs act {size} ± 0.01 ms late" in message
    assert advice in message.partition(";")[2]


def test_two_things_that_are_surely_off_together_are_no_tie() -> None:
    heavy = Belief("m1", False, "mass", 0.98, 0.03, 0.001)
    found = messages((late(0.5), heavy))
    assert len(found) == 2
    assert not any("do not tell" in message for message in found)
