"""Where a line stands between its bin and the one beside it, and what of it leaks into others."""

from typing import Any

import numpy as np
import pytest

from agent.numerics.inference import tuning
from agent.numerics.inference.noise.lines import MEDIAN, _leakage, _standing_out, between
from agent.numerics.inference.noise.state import Places

BINS = np.arange(501)


NOWHERE = Places.unseen(501, 1)


def spectrum_of(cycles: float, background: float, seed: int = 1) -> np.ndarray:
    """Residual (b,) of a line of 10,000 σ² in noise that is `background` σ² in each bin."""
    line = np.fft.rfft(np.cos(2 * np.pi * cycles * np.arange(1000) / 1000 + 0.3 * seed)) / 500
    rng = np.random.default_rng(seed)
    noise = np.sqrt(0.5 * background) * (rng.standard_normal(501) + 1j * rng.standard_normal(501))
    return np.asarray(100 * line + noise)


def off_of(cycles: float) -> np.ndarray:
    """Places (b,) as one window without noise shows them."""
    return NOWHERE.after(spectrum_of(cycles, 0.0)[:, None], BINS).off[:, 0]


def level_of(power: np.ndarray) -> np.ndarray:
    """What is known of the bins: the line, and that nothing else is there."""
    return np.where(power > 0.5 * power.max(), power, 1.0)


@pytest.mark.parametrize("cycles", [40.0, 40.2, 40.45, 39.8, 39.55])
def test_line_between_two_bins_is_found_from_their_amplitudes(cycles: float) -> None:
    spectrum = np.abs(np.fft.rfft(np.cos(2 * np.pi * cycles * np.arange(1000) / 1000 + 0.3)))
    found = 40 + between(float(spectrum[40]), float(spectrum[39]), float(spectrum[41]))
    assert found == pytest.approx(cycles, abs=0.01)
    assert between(0.0, 0.0, 0.0) == 0.0


@pytest.mark.parametrize("cycles", [40.0, 40.2, 40.45, 39.8, 39.55])
def test_line_between_two_bins_is_found_by_windows_of_any_phase(cycles: float) -> None:
    places = NOWHERE
    for window in range(10):
        places = places.after(spectrum_of(cycles, 4.0, window)[:, None], BINS)
    assert 40 + places.off[40, 0] == pytest.approx(cycles, abs=0.01)


def test_line_of_which_no_window_shows_anything_is_at_its_bin() -> None:
    assert not NOWHERE.off.any()
    assert not NOWHERE.after(np.zeros((501, 1), dtype=complex), BINS).off.any()


def test_place_is_not_taken_from_bins_that_are_not_next_to_one_another() -> None:
    every_other = np.delete(BINS, 41)
    places = NOWHERE.after(spectrum_of(40.2, 0.0)[every_other, None], every_other)
    assert not places.off[[40, 42], 0].any()
    assert places.off[39, 0]


@pytest.mark.parametrize("cycles", [40.2, 40.4, 39.7])
def test_leakage_is_that_of_the_line(cycles: float) -> None:
    power = np.abs(spectrum_of(cycles, 0.0)) ** 2
    found = _leakage(level_of(power), power, BINS, off_of(cycles), alone=True)
    for k in (36, 38, 39, 41, 42, 45):
        assert found[k] - 1 == pytest.approx(power[k], rel=0.2)


def test_what_forces_leave_beside_a_line_does_not_leak_with_it() -> None:
    power = np.abs(spectrum_of(40.2, 1e6)) ** 2
    level = np.where(BINS == 40, 1e4, 1.0)
    # the work of forces, a hundred times as strong as the line, leaked with it
    beyond = np.abs(BINS - 40) > 8
    off = off_of(40.2)
    assert _leakage(level, power, BINS, off, alone=True)[beyond].max() < 40
    # windows too short to show colours
    assert _leakage(level, power, BINS, off, alone=False)[beyond].max() > 200


def coloured_power(bins: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Power (b,) far above what is known in all bins, with lines at the ends and inside; shapes (b, 3)."""
    rng = np.random.default_rng(seed)
    power = 50 * rng.exponential(size=bins)
    power[[9, 30, bins // 2, bins - 3]] *= 400
    shapes = rng.exponential(size=(bins, 3)) + 0.1
    shapes[30, 1] *= 400  # the motion has that peak too
    return power, shapes


@pytest.mark.parametrize("bins", [40, 51, 400])
def test_lines_are_bins_that_stand_out_from_those_within_reach(bins: int) -> None:
    power, shapes = coloured_power(bins, bins)
    reach, least = tuning.LINE_NEIGHBOURS, tuning.LINE_POWER / MEDIAN
    places, sizes = _standing_out(power, np.arange(bins), power, shapes)
    found = {}
    for k in range(tuning.LINE_CYCLES, bins):
        about = slice(max(0, k - reach), k + reach + 1)
        usual = float(np.median(power[about]))
        beside = np.median(power[about, None] / shapes[about], axis=0)
        is_high = power[k] > max(least * usual, tuning.LINE_POWER)
        if is_high and (power[k] / shapes[k] > least * beside).all():
            found[k] = power[k] / max(usual / MEDIAN, 1.0)
    assert dict(zip(places.tolist(), sizes.tolist(), strict=True)) == found
    assert {9, bins - 3} <= set(found)
    assert 30 not in found


def test_lines_are_sought_in_all_loud_bins_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    power, shapes = coloured_power(4000, 1)
    median, calls = np.median, []

    def counted(*args: Any, **more: Any) -> Any:
        calls.append(args)
        return median(*args, **more)

    monkeypatch.setattr(np, "median", counted)
    _standing_out(power, np.arange(4000), power, shapes)
    # whole neighbourhoods together, those at the ends one by one
    assert len(calls) <= 2 + 4 * tuning.LINE_NEIGHBOURS
