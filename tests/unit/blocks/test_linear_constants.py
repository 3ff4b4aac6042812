"""Gains of a linear rig: one that an uncertain entry can do in its place is never said to be off."""

from pathlib import Path

import numpy as np
import pytest

from agent.blocks.statistical_rig import statistical_rig
from agent.config import load
from tests.scenario.test_linear_rigs import DISCRETE

OPEN = DISCRETE.replace("gain_sd_percent = 0.0\n", "")


@pytest.mark.parametrize("bias", ["", "bias = true\n"])
@pytest.mark.parametrize(
    ("uncertain", "direct", "hidden"),
    [
        ('"A[1,0]", "B"', True, set()),  # D, which is known, keeps B from doing the input's gain
        ('"A[1,0]", "B"', False, {"drive"}),
        ('"C"', False, {"drive", "y1", "y2"}),
    ],
)
def test_gain_that_entries_can_do_in_its_place_does_not_show(
    tmp_path: Path, uncertain: str, direct: bool, hidden: set[str], bias: str
) -> None:
    file = tmp_path / "rig.toml"
    text = OPEN.replace('"A[1,0]", "A[0,0]", "C[0,0]", "D[1,0]"', uncertain)
    text = text if direct else text.replace("D = [[0.0], [0.02]]\n", "")
    file.write_text(
        text[: text.index("[[alarm]]")].replace("noise_sd = 1e-4\n", f"noise_sd = 1e-4\n{bias}", 1)
    )
    constants = statistical_rig(load(file)).constants
    assert {constant.name for constant in constants if not constant.shows} == hidden


def test_entry_of_nothing_has_the_size_of_a_share_of_its_matrix(tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    text = OPEN.replace('"A[1,0]", "A[0,0]", "C[0,0]", "D[1,0]"', '"D[0,0]", "A[0,0]"')
    file.write_text(text[: text.index("[[alarm]]")])
    rig = statistical_rig(load(file))
    np.testing.assert_allclose(rig.scale, [0.1 * 0.02, 0.95])
