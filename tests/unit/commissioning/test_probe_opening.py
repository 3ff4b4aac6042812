"""A device that comes up while it is probed is listened to; one that stays away is named."""

from types import SimpleNamespace
from typing import Any

from agent.commissioning.probe import _turn
from agent.errors import Fault
from drivers.reconnect import LinkEvent


def turned(lost: dict[str, Fault], *events: LinkEvent) -> dict[str, Fault]:
    """What is known of one source after a turn in which its connection said these."""
    use = SimpleNamespace(source="serial", columns=("x1",), covariates=())
    connection: Any = SimpleNamespace(take=lambda: ([], list(events)), uses=[use], counts=None)
    gathering: Any = SimpleNamespace(counts={})
    _turn(gathering, [connection], set(), lost)
    return lost


def test_line_that_is_not_there_yet_is_no_fault_once_it_delivers() -> None:
    missing = LinkEvent("lost", "no such file", 0.0)
    lost = turned({}, missing)
    assert lost["serial"].message == "no such file"
    assert turned(lost) == lost
    assert turned(lost, LinkEvent("recovered", "serial: delivers samples again", 1.0)) == {}
    assert turned({}, missing, LinkEvent("recovered", "serial: delivers samples again", 1.0)) == {}
