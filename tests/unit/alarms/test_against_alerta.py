"""The life cycle against alerta-server's, which others wrote: they differ just where the documents say."""

import json
import os
import random
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from agent.alarms.life_cycle import CAUSES, STATES, SUPPRESSED, Alarm
from tests import peers
from tests.conftest import SEED
from tests.figures import figure

HERE = Path(__file__).parent
KEPT = HERE / "alerta-server.json"
STANDS = {"NORM": (False,), "UNACK": (True,), "ACKED": (True,), "RTNUN": (False,)}
"""Whether the condition stands, where the state says so; the others leave it open."""
ACTS = {"acknowledge": "ack", "shelve": "shelve", "unshelve": "unshelve", "expire": "timeout"}

Answers = dict[tuple[Any, ...], str]


class Place(NamedTuple):
    """What may be asked: a cause in a state, the condition standing or not."""

    cause: Any
    state: Any
    stands: bool


PLACES = [
    Place(cause, state, stands)
    for cause in CAUSES
    for state in STATES
    for stands in STANDS.get(state, (False, True))
]


def read(text: str) -> Answers:
    return {tuple(row[:4]): row[4] for row in json.loads(text)["rows"]}


def theirs(answers: Answers, place: Place) -> str:
    """Return the state that alerta-server comes to."""
    cause, state, stands = place
    now = "Medium" if stands else "OK"
    if cause in {"suppress", "out of service"}:
        return "DSUPR" if cause == "suppress" else "OOSRV"
    events = {"raise": (now, "Medium"), "clear": (now, "OK"), "re-alarm": (now, "High" if stands else "OK")}
    return answers[(state, *events.get(cause, (now, now)), ACTS.get(cause))]


def ours(place: Place) -> str:
    """Return the state that we come to; "x" where we refuse."""
    after = Alarm(place.state, place.stands).step(place.cause)
    return "x" if after is None else after.state


def listed() -> dict[Place, tuple[str, str]]:
    """Return what the documents say of each place where the two differ: alerta-server's state, ours."""
    text = (peers.ROOT / "docs" / "alarm-states.md").read_text(encoding="utf-8")
    found: dict[Place, tuple[str, str]] = {}
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 5 and cells[0] in CAUSES:
            for place in PLACES:
                if place.cause == cells[0] and place.state in cells[1].split(", "):
                    assert place not in found, f"{place} stands in two rows"
                    found[place] = _meant(cells[2], place), _meant(cells[3], place)
    return {place: pair for place, pair in found.items() if pair[0] != pair[1]}


def _meant(cell: str, place: Place) -> str:
    if cell == "-":
        return str(place.state)
    active, _, normal = cell.partition("/")
    return normal if normal and not place.stands and place.cause != "raise" else active


def play(answers: Answers, events: int) -> tuple[int, int]:
    """Play random events to both; return how often they agreed and how often they differed as the documents
    say."""
    rng, differences, seen = random.Random(SEED), listed(), Counter[bool]()
    alarm = Alarm()
    for _ in range(events):
        place = Place(rng.choice(CAUSES), alarm.state, alarm.stands)
        pair = theirs(answers, place), ours(place)
        assert (pair[0] == pair[1]) != (place in differences), (place, pair)
        assert differences.get(place, pair) == pair
        seen[place in differences] += 1
        alarm = alarm.step(place.cause) or alarm
    return seen[False], seen[True]


def test_life_cycle_differs_from_that_of_alerta_server_just_where_the_documents_say() -> None:
    answers = read(KEPT.read_text(encoding="utf-8"))
    found = {place: pair for place in PLACES if (pair := (theirs(answers, place), ours(place)))[0] != pair[1]}
    assert found == listed()
    assert {place.state for place in found} >= set(SUPPRESSED)
    agreed, differed = play(answers, 10_000)
    assert min(agreed, differed) > 1000


def python_with_alerta(folder: Path) -> str:
    """Return a Python that has alerta-server: that of DELTAK_ALERTA, or of an environment made for it."""
    if "DELTAK_ALERTA" in os.environ:
        return os.environ["DELTAK_ALERTA"]
    subprocess.run([sys.executable, "-m", "venv", folder], check=True, capture_output=True, timeout=120)
    python = folder / "bin" / "python"
    wanted = f"alerta-server=={json.loads(KEPT.read_text(encoding='utf-8'))['version']}"
    command = [python, "-m", "pip", "install", "-q", wanted]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=600)
    if done.returncode != 0:
        peers.missing(f"{wanted} could not be installed: {done.stderr[-300:]}")
    return str(python)


@pytest.mark.soak
@pytest.mark.timeout(900)
def test_hundred_thousand_events_are_played_to_alerta_server_itself(tmp_path: Path) -> None:
    command = [python_with_alerta(tmp_path / "alerta"), str(HERE / "alerta_server.py")]
    text = subprocess.run(command, check=True, capture_output=True, text=True, timeout=120).stdout
    assert json.loads(text) == json.loads(KEPT.read_text(encoding="utf-8"))
    agreed, differed = play(read(text), 100_000)
    figure(
        f"alarm states beside alerta-server: {agreed} of 100000 events agree, "
        f"{differed} differ as listed, 0 others"
    )
