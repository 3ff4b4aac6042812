"""The comparison as make bench runs it: the table is printed, and what the README says of it is held."""

import numpy as np
import pytest

from tests.bench import comparison

pytestmark = pytest.mark.bench


def test_comparison_joint_ekf_costs_at_most_half_more_than_filterpys_own_step() -> None:
    own, ours = comparison.filterpys_own_step(), comparison.joint_ekf_step()
    print(f"\njoint EKF {ours:.1f} us a step, filterpy's own {own:.1f} us")
    assert ours <= 1.5 * own


@pytest.mark.parametrize("sigma", comparison.SIGMAS)
def test_comparison_window_ml_is_more_exact_after_jumps_cheaper_in_steady_running_and_isolated(sigma: float) -> None:
    results = comparison.compare(sigma)
    print("\n" + "\n".join(comparison.table(sigma, results)))
    scores = {contender.name: (score, steady, shift) for contender, score, steady, shift in results}
    product, steady, shift = scores["window-ml 0.25 s"]
    for rival in ("joint EKF", "joint UKF", "RLS", "seed re-centred", "seed as printed"):
        assert product.jump <= scores[rival][0].jump
        assert np.isnan(scores[rival][2]) or shift < 0.1 * scores[rival][2]
    assert product.coverage == pytest.approx(0.95, abs=0.04)
    assert scores["joint EKF"][1] / steady >= 40.0
    assert scores["joint UKF"][1] / steady >= 400.0
