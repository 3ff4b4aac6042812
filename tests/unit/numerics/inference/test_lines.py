"""Where a line stands between its bin and the one beside it."""

import numpy as np
import pytest

from agent.numerics.inference.noise.lines import between


@pytest.mark.parametrize("cycles", [40.0, 40.2, 40.45, 39.8, 39.55])
def test_line_between_two_bins_is_found_from_their_amplitudes(cycles: float) -> None:
    spectrum = np.abs(np.fft.rfft(np.cos(2 * np.pi * cycles * np.arange(1000) / 1000 + 0.3)))
    found = 40 + between(float(spectrum[40]), float(spectrum[39]), float(spectrum[41]))
    assert found == pytest.approx(cycles, abs=0.01)


def test_line_of_which_a_window_shows_nothing_is_at_its_bin() -> None:
    assert between(0.0, 0.0, 0.0) == 0.0
