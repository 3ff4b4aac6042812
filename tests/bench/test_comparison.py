"""The comparison as make bench runs it: the table is printed, and what the README says of it is held."""

import numpy as np
import pytest

from tests.bench import comparison

pytestmark = pytest.mark.bench


def test_comparison_joint_ekf_costs_at_most_half_more_than_filterpys_own_step() -> None:
    ours, own = comparison.joint_ekf_and_filterpys_own()
    print(f"\njoint EKF {ours:.1f} us a step, filterpy's own {own:.1f} us")
    assert ours <= 1.5 * own


@pytest.mark.parametrize("sigma", comparison.SIGMAS)
def test_comparison_window_ml_is_more_exact_after_jumps_and_isolated(sigma: float) -> None:
    results = comparison.compare(sigma)
    print("\n" + "\n".join(comparison.table(sigma, results)))
    scores = {contender.name: (score, steady, shift) for contender, score, steady, shift in results}
    product, _, shift = scores["window-ml 0.25 s"]
    for rival in ("joint EKF", "joint UKF", "RLS", "seed re-centred", "seed as printed"):
        assert product.jump <= scores[rival][0].jump
        assert np.isnan(scores[rival][2]) or shift < 0.1 * scores[rival][2]
    assert product.coverage == pytest.approx(0.95, abs=0.04)


@pytest.mark.parametrize("sigma", comparison.SIGMAS)
def test_comparison_window_ml_costs_a_130th_of_the_ekf_and_an_800th_of_the_ukf(sigma: float) -> None:
    steady = {contender.name: cost for contender, _, cost, _ in comparison.compare(sigma)}
    for product in ("window-ml 0.25 s", "window-ml 0.5 s"):
        ekf, ukf = (steady[name] / steady[product] for name in ("joint EKF", "joint UKF"))
        print(
            f"\nsteady at {sigma * 1e6:g} um: {product} {ekf:.0f} x cheaper than the EKF, "
            f"{ukf:.0f} x than the UKF"
        )
        assert ekf >= 130.0
        assert ukf >= 800.0
