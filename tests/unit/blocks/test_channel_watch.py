"""What is said of a channel that reads wrongly, in its own unit."""

import pytest

from agent.blocks.channel_watch import ChannelWatch, Named
from agent.config.model.tables import Channel
from agent.numerics.inference.channels import Fault, Kind


def said(quantity: str, unit: str, kind: Kind, size: float) -> str:
    channel = Channel(name="one", quantity=quantity, at="m1", unit=unit)
    return ChannelWatch("rig", (Named.of(channel),)).words(Fault(0, kind, size, 0.0))


@pytest.mark.parametrize(
    ("quantity", "unit", "size", "amount"),
    [
        ("force", "N", 0.61, "0.61 N"),
        ("force", "N", 0.05, "50 mN"),
        ("force", "N", 0.0, "0 N"),
        ("force", "kN", 610.0, "0.61 kN"),
        ("force", "V", 0.599, "0.599 V"),
        ("force", "V", 0.05, "0.05 V"),
    ],
)
def test_an_input_that_stood_is_said_in_its_unit(quantity: str, unit: str, size: float, amount: str) -> None:
    assert said(quantity, unit, "stood", size).startswith(f"one stood at {amount} while the rig moved; check")


@pytest.mark.parametrize(
    ("unit", "size", "words"),
    [
        ("m", 2e-3, "2 mm too much"),
        ("mm", 2e-3, "2 mm too much"),
        ("mm", -5e-5, "0.05 mm too little"),
        ("counts", -65.8, "65.8 counts too little"),
    ],
)
def test_an_offset_is_said_in_the_unit_of_its_channel(unit: str, size: float, words: str) -> None:
    assert said("displacement", unit, "offset", size).startswith(f"one reads {words}; set its zero anew")
