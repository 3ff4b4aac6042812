"""Random rigs that are no chains, right or nearly right: rows stay valid, intervals hold, nobody is accused
falsely."""

from collections.abc import Iterable, Sequence
from functools import partial

import pytest

from tests.statistical.machine import each, say
from tests.statistical.nearly_right import Found, hold, least, together
from tests.statistical.random_rigs import DRIVEN, FAULTS, PAIRS, case, drawn, play

WINDOWS, RECORDINGS, RIGS = 40, 2, 6
SHEET_RIGS = 40
FIRST_SEED = 7000
DRAWN_SEEDS, DRAWN_WINDOWS = range(700000, 700240), 20
KINDS: tuple[tuple[str, ...], ...] = ((), *((kind,) for kind in (*FAULTS, *sorted(DRIVEN))), *PAIRS)
QUICK = (
    (1, ("AR sensors", "one output"), 20),
    (3, ("one mass", "hum"), 20),
    (7501, ("gain drifts",), 20),
    (7502, ("gain drifts",), 40),
    (7331, ("one mass",), 8),
    (8231, ("three digits",), 6),
    (8231, ("three digits of g",), 6),
    (8603, ("one mass", "hum"), 8),
    (30141, ("all masses", "hum"), 20),
    (700203, ("hum", "all masses"), 4),
    (701188, ("gain", "gain drifts"), 20),
    (700103, ("one mass", "noise not stated"), 20),
    (950083, ("hum", "force noise"), 20),
    (10003, ("gain drifts", "all masses"), 40),
    (15004, ("data sheets",), 8),
    (15007, ("data sheets",), 8),
)
LONGER = (
    (8705, ("gain drifts", "unknown force"), 20),
    (9031, ("force noise", "one output"), 20),
    (9103, ("hum", "unknown force"), 40),
    (9303, ("three digits", "noise stated"), 20),
    (9127, ("one mass", "one output"), 40),
    (9250, ("one mass", "unknown force"), 20),
    (30035, ("all masses", "held"), 20),
    (700040, ("gain drifts", "one mass"), 12),
    (820002, ("gain drifts", "one mass"), 6),
    (950140, ("AR sensors", "one output"), 20),
    (960147, ("one output", "one mass"), 6),
)
"""Rigs, by their seeds, what is wrong with them, and windows: of 7501 and 8705 each window shows a gain that
drifts, of 7502 a row breaks after thirty, of 7331 and 9031 two explanations tie whose terms of second order
are larger than what either leaves open, of 8231 a table's step is tenfold at the peaks, in SI
or before it is scaled, of 8603 divide and
conquer finds no singular values of a factor of the bank's, of 9103 forces leak with the hum, of 9303 windows
are rounded a hundred times as coarsely as others, of 9127 belief slides to what is configured after fifteen,
of 9250 no window comes to rest under the noise of the sensors alone, of 30035 a force that is held hides what
else is off, of 30141 readings are so precise that intervals end at what one of three explanations says, of
700040 a drift hides whose the rest of a scale is, of 820002 all is exact but a mass whose own sensor drifts,
of 700203 all modes are elsewhere than configured, of 701188 other parameters explain in each window what a
gain's drift does, of 700103 ten explanations are each straight somewhere else, of 950083 hum stands between
two bins beside a force that is noisy, of 950140 a mass stands at 3 to 1 where its sensor is off, of 960147 a
mass and a sensor are off at once, of 10003 a drift looks like another jump in each window. Those that take
long are left to the soak."""


def name_of(kinds: Iterable[str]) -> str:
    return ", ".join(kinds) or "right"


@pytest.mark.parametrize(
    ("seed", "kinds", "windows"), [*QUICK, *(pytest.param(*one, marks=pytest.mark.soak) for one in LONGER)]
)
def test_random_rig_that_is_nearly_right_gives_valid_rows_that_hold(
    seed: int, kinds: tuple[str, ...], windows: int, request: pytest.FixtureRequest
) -> None:
    found = play(seed, kinds, 0, windows)
    say(request, f"{name_of(kinds)}, rig {seed}, {windows} windows: {found}")
    hold(name_of(kinds), case(seed, kinds), found, 0.5)


def test_blow_before_any_window_was_learnt_from_does_not_end_the_estimation(
    request: pytest.FixtureRequest,
) -> None:
    """Blows of a rig whose first window nothing fits."""
    found = play(41337, ("noise stated", "one mass"), 0, 6)
    say(request, f"a blow before any window was learnt from, 6 windows: {found}")
    assert found.valid.any()
    assert found.cover > 0.9


@pytest.mark.soak
def test_masses_that_no_window_tells_apart_are_both_believed(request: pytest.FixtureRequest) -> None:
    """One sensor over two masses: what windows ask of both turns with where they are linearised.

    Weighed about one point for all, windows refute the mass that is off: three of five parameters are wrong.
    """
    found = play(8805, ("noise stated", "one mass"), 0, 12)
    say(request, f"one sensor over two masses, 12 windows: {found}")
    assert min(found.last["m1"], found.last["m2"]) > 0.05
    assert found.cover > 0.75
    assert not found.alarms


@pytest.mark.soak
@pytest.mark.parametrize("kinds", KINDS, ids=name_of)
def test_random_rigs_that_are_nearly_right_give_valid_rows_that_hold(
    kinds: tuple[str, ...], request: pytest.FixtureRequest
) -> None:
    first = FIRST_SEED + 100 * KINDS.index(kinds)
    seeds = range(first, first + RIGS)
    found = list(zip(seeds, each(partial(_rig, kinds), seeds), strict=True))
    for seed, one in found:
        say(request, f"{name_of(kinds)}, rig {seed}, {RECORDINGS} x {WINDOWS} windows: {one}")
    for seed, one in found:
        hold(f"{name_of(kinds)}, rig {seed}", case(seed, kinds), one, 0.5, unsure=True)


@pytest.mark.soak
def test_random_rigs_whose_constants_are_as_their_data_sheets_say_give_intervals_that_hold(
    request: pytest.FixtureRequest,
) -> None:
    """Constants are common to all windows of a rig: intervals hold by rigs, and one in twenty may not."""
    found = list(each(_of_sheets, range(15000, 15000 + SHEET_RIGS)))
    known = [f for f in found if f.valid.any()]
    cover = sum(f.cover for f in known) / len(known)
    say(request, f"data sheets, {len(found)} rigs: {100 * cover:.1f} % hold, of {_understood(found)} rows")
    assert cover >= least(0.93, len(known))
    assert _understood(found) >= 0.97
    assert not [f.alarms for f in found if f.alarms]
    assert not [wrong for f in found if (wrong := f.wrong(frozenset()))]


@pytest.mark.soak
def test_random_rigs_with_kinds_drawn_at_random_are_seldom_beyond_the_bounds(
    request: pytest.FixtureRequest,
) -> None:
    """Up to three imperfections; some of them, such as two scales far off at once, no data tell."""
    beyond = []
    for seed, found in zip(DRAWN_SEEDS, each(_of_drawn, DRAWN_SEEDS), strict=True):
        kinds = drawn(seed)
        try:
            hold(name_of(kinds), case(seed, kinds), found, 0.0, unsure=True)
        except AssertionError as wrong:
            beyond.append(f"{seed} {wrong}".splitlines()[0])
    say(request, f"drawn at random, {len(DRAWN_SEEDS)} rigs, {len(beyond)} beyond the bounds: {beyond}")
    assert len(beyond) <= 0.05 * len(DRAWN_SEEDS)


def _of_drawn(seed: int) -> Found:
    return play(seed, drawn(seed), 0, DRAWN_WINDOWS)


def _understood(found: Sequence[Found]) -> float:
    """Share of rows that are understood."""
    return sum(f.understood for f in found) / len(found)


def _of_sheets(seed: int) -> Found:
    return play(seed, ("data sheets",), 0, 10)


def _rig(kinds: tuple[str, ...], seed: int) -> Found:
    return together([play(seed, kinds, recording, WINDOWS) for recording in range(RECORDINGS)])
