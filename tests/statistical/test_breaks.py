"""A spring that breaks is alarmed and followed, a mass that is loaded is named, on rigs drawn at random."""

from collections.abc import Callable
from functools import partial

import pytest

from tests.statistical.breaks import BROKEN, HEAVIER, LIGHTER, STIFFER, Changed, broken, loaded
from tests.statistical.machine import each, say

QUICK = ((980000, BROKEN), (980006, BROKEN), (980030, BROKEN), (980039, BROKEN), (980041, STIFFER))
"""Rigs and what is left of a spring: of the first two it breaks under blows, which without it come out other
than they were read; of the third all modes move; of the last a spring is three times as stiff."""
LOADED = (995007, 996013, 996022, 996027)
"""Rigs of which a mass becomes a tenth to a third heavier: under blows, which are other than they were read
while the mass is believed to be what it was."""
FULL = 60


@pytest.mark.parametrize(("seed", "left"), QUICK)
def test_spring_that_breaks_is_alarmed_and_followed(
    seed: int, left: tuple[float, float], request: pytest.FixtureRequest
) -> None:
    found = broken(seed, left)
    say(request, f"rig {seed}: {found}")
    assert found.met


@pytest.mark.parametrize("seed", LOADED)
def test_mass_that_is_loaded_is_named_and_no_parameter_alarmed(
    seed: int, request: pytest.FixtureRequest
) -> None:
    found = loaded(seed, HEAVIER)
    say(request, f"rig {seed}: {found}")
    assert found.met


@pytest.mark.soak
@pytest.mark.parametrize("to", [HEAVIER, LIGHTER], ids=["heavier", "lighter"])
def test_masses_that_are_loaded_are_named_and_no_parameter_alarmed_on_random_rigs(
    to: tuple[float, float], request: pytest.FixtureRequest
) -> None:
    found = _rigs(partial(loaded, to=to), 998000)
    named = sum(one.name in one.verdicts for one in found.values())
    missed = {seed: one for seed, one in found.items() if not one.met}
    say(
        request,
        f"a mass becomes {to[0]:g} to {to[1]:g} times itself, {FULL} rigs: {named} named, "
        f"{len(missed)} not as they are to be: {missed}",
    )
    assert len(missed) <= 0.1 * FULL


@pytest.mark.soak
@pytest.mark.parametrize("left", [BROKEN, STIFFER], ids=["breaks", "stiffer"])
def test_springs_that_break_are_alarmed_and_followed_on_random_rigs(
    left: tuple[float, float], request: pytest.FixtureRequest
) -> None:
    found = _rigs(partial(broken, left=left), 990000)
    beyond = [one for one in found.values() if one.beyond]
    alarmed = sum(one.name in one.alarms for one in beyond)
    missed = {seed: one for seed, one in found.items() if not one.met}
    say(
        request,
        f"a spring has {left[0]:g} to {left[1]:g} of its stiffness, {FULL} rigs: {alarmed} of {len(beyond)} "
        f"beyond their limits alarmed, {len(missed)} not as they are to be: {missed}",
    )
    assert len(missed) <= 0.05 * FULL


def _rigs(play: Callable[[int], Changed], first: int) -> dict[int, Changed]:
    """What is said of so many rigs, by their seeds."""
    seeds = range(first, first + FULL)
    return dict(zip(seeds, each(play, seeds), strict=True))
