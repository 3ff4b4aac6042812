"""The table of alarm states against a second one, made of predicates from the standard's diagram."""

import random
from dataclasses import dataclass
from pathlib import Path

import pytest

from agent.alarms.life_cycle import CAUSES, COMMANDS, STATES, SUPPRESSED, TABLE, Alarm, after, cause_of
from tests.peers import ROOT


@dataclass
class Standard:
    """Clause 5.4 of ANSI/ISA-18.2-2016 told as facts about an alarm, not as a table of states."""

    active: bool = False
    accepted: bool = True
    shelved: bool = False
    designed: bool = False
    removed: bool = False

    @property
    def silent(self) -> bool:
        return self.shelved or self.designed or self.removed

    @property
    def name(self) -> str:
        if self.removed:
            return "OOSRV"
        if self.shelved:
            return "SHLVD"
        if self.designed:
            return "DSUPR"
        if self.active:
            return "ACKED" if self.accepted else "UNACK"
        return "NORM" if self.accepted else "RTNUN"

    def announce(self, *, accepted: bool) -> None:
        """Come back from a silent state: what stands is shown anew, what is over is normal."""
        self.shelved = self.designed = self.removed = False
        self.accepted = accepted or not self.active

    def take(self, cause: str) -> bool:
        """Do it; False where the operator asks for what the state does not allow."""
        acts = {
            "raise": self.occur, "clear": self.go, "acknowledge": self.accept, "shelve": self.shelve,
            "unshelve": lambda: self.leave(self.shelved and not self.removed, accepted=True),
            "return": lambda: self.leave(self.removed, accepted=False),
            "out of service": self.remove,
        }  # fmt: skip
        if cause in acts:
            return acts[cause]() is not False
        if cause == "expire" and self.name == "SHLVD":
            self.announce(accepted=False)
        if cause == "suppress" and not self.silent:
            self.designed = True
        if cause == "unsuppress" and self.name == "DSUPR":
            self.announce(accepted=False)
        if cause == "re-alarm" and self.name == "ACKED":
            self.accepted = False
        return True

    def occur(self) -> None:
        if not self.active and not self.silent:
            self.accepted = False
        self.active = True

    def go(self) -> None:
        self.active = False

    def accept(self) -> bool:
        possible = not self.silent and not self.accepted
        self.accepted = self.accepted or possible
        return possible

    def shelve(self) -> bool:
        possible = not self.shelved and not self.removed
        self.designed = self.designed and not possible
        self.shelved = self.shelved or possible
        return possible

    def remove(self) -> bool:
        possible = not self.removed
        self.shelved = self.designed = False
        self.removed = True
        return possible

    def leave(self, possible: bool, *, accepted: bool) -> bool:
        if possible:
            self.announce(accepted=accepted)
        return possible


def play(seed: int, events: int) -> None:
    """Hold one alarm against the other over random events, and what must hold whatever happens."""
    rng = random.Random(seed)
    alarm, other = Alarm(), Standard()
    for number in range(events):
        cause = rng.choice(CAUSES)
        before = alarm
        found = alarm.step(cause)
        assert (found is not None) == other.take(cause), (number, before, cause)
        alarm = found or alarm
        assert (alarm.state, alarm.stands) == (other.name, other.active), (number, before, cause)
        assert found is not None or cause in COMMANDS, "what happens by itself is never refused"
        assert alarm.stands == before.stands or cause in {"raise", "clear"}, (
            "only its condition changes a condition"
        )
        if before.state in SUPPRESSED and cause in {"raise", "clear", "re-alarm"}:
            assert alarm.state == before.state, "a suppressed alarm announces nothing"
        if alarm.state not in SUPPRESSED:
            assert alarm.stands == (alarm.state in {"UNACK", "ACKED"})


def test_life_cycle_follows_the_standard_over_random_events() -> None:
    for seed in range(10):
        play(seed, 500)


@pytest.mark.soak
def test_life_cycle_follows_the_standard_over_a_hundred_thousand_events() -> None:
    for seed in range(100):
        play(seed + 1000, 1000)


def test_table_is_total_and_stands_in_the_alarm_document() -> None:
    for state in STATES:
        for cause in CAUSES:
            for stands in (False, True):
                assert after(state, cause, stands=stands) in {*STATES, None}
    assert TABLE in Path(ROOT / "deploy" / "ALARMS.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("before", "to", "cause"),
    [
        ("NORM", "UNACK", "raise"),
        ("RTNUN", "UNACK", "raise"),
        ("UNACK", "RTNUN", "clear"),
        ("ACKED", "NORM", "clear"),
        ("RTNUN", "NORM", None),
        ("UNACK", "ACKED", None),
    ],
)
def test_cause_of_a_detectors_step_is_what_the_process_did(before: str, to: str, cause: str | None) -> None:
    assert cause_of(before, to) == cause  # type: ignore[arg-type]
