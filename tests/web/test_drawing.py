"""What the page draws of a rig of another domain: its own names, between the places that the file says."""

from typing import Any

import pytest

from agent.cli.tuning import DRAWN_ELEMENTS
from agent.cli.web.model import drawing
from agent.config import load
from tests.peers import ROOT

DRAWN: dict[str, tuple[list[str], list[tuple[str, str, int, int]]]] = {
    "oven": (["core", "shell", "room"], [("R1", "resistance", 1, 2), ("R2", "resistance", 2, 3)]),
    "transfer_line": (["T2", "T1"], [("valve", "restriction", 0, 1), ("pipe", "line", 1, 2)]),
    "gantry": (["foot", "corner", "tip"], [("post", "beam", 1, 2), ("arm", "beam", 2, 3)]),
    "geared_drive": (
        ["rotor", "load"], [("k", "shaft", 1, 2), ("b1", "bearing", 0, 1), ("b2", "bearing", 0, 2)],
    ),
    "dc_drive": (["L", "J"], [("R", "element", 0, 1), ("K", "element", 1, 2), ("b", "element", 0, 2)]),
    "rlc_filter": (
        ["L1", "C1", "L2", "C2"],
        [("R1", "element", 0, 1), ("R2", "element", 0, 3), ("load", "element", 0, 4),
         ("", "wire", 1, 2), ("", "wire", 3, 4), ("", "wire", 2, 3)],
    ),
    "voice_coil": (
        ["current", "velocity", "position"],
        [("R", "element", 0, 1), ("k", "element", 2, 3), ("b", "element", 0, 2), ("K", "element", 1, 2)],
    ),
}  # fmt: skip


def shown(document: dict[str, Any]) -> tuple[list[str], list[tuple[str, str, int, int]]]:
    boxes = sorted(document["masses"], key=lambda mass: mass["place"])
    rows = [(e["name"], e["kind"], e["from"], e["to"]) for e in document["elements"]]
    return [box["name"] for box in boxes], rows


@pytest.mark.parametrize("name", DRAWN)
def test_rig_of_another_domain_is_drawn_by_its_own_names(name: str) -> None:
    config = load(ROOT / f"deploy/examples/{name}.toml")
    boxes, rows = shown(drawing(config))
    assert boxes == DRAWN[name][0]
    assert sorted(rows) == sorted(DRAWN[name][1])


def test_no_more_entries_are_drawn_than_can_be_looked_at() -> None:
    config = load(ROOT / "deploy/examples/voice_coil.toml")
    A = tuple(tuple(float(i == j) for j in range(6)) for i in range(6))
    model = config.model.model_copy(update={"A": A, "state": (), "parameter": (), "uncertain": ("A",)})
    names = tuple(parameter.name for parameter in model.parameters)  # type: ignore[union-attr]
    many = config.estimator.model_copy(update={"estimate": names})
    found = drawing(config.model_copy(update={"model": model, "estimator": many}))
    assert (len(found["masses"]), len(found["elements"])) == (6, DRAWN_ELEMENTS)
