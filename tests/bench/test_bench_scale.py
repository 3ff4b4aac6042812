"""Scale as make bench runs it: tables are printed, and what must not get lost is held."""

import pytest

from tests.bench import bench_scale

MILLION = 1_000_000


@pytest.mark.bench
def test_scale_of_models_and_rigs_keeps_its_rates() -> None:
    by_states, by_rigs = bench_scale.by_states(), bench_scale.by_rigs()
    print()
    for states, parameters, found in by_states:
        print(f"{states} states, {parameters} parameters: {found / 1e6:.2f} M samples/s")
    for rigs, found in by_rigs:
        print(f"{rigs} rigs of one model: {found / 1e6:.2f} M samples/s together")
    rates = dict(by_rigs)
    assert rates[64] > 0.6 * rates[1]
    # four parameters of a chain of eight masses come with 19 columns of constants: masses, gains, the delay
    assert min(found for states, parameters, found in by_states if parameters <= 4 and states <= 8) > (
        0.2 * MILLION
    )
    assert min(found for _, parameters, found in by_states if parameters <= 4) > 0.05 * MILLION


@pytest.mark.bench
def test_scale_of_windows_costs_less_than_each_of_them_alone() -> None:
    (_, one), (several, all_of_them) = bench_scale.by_windows()
    print(
        f"\n1 window {one / 1e6:.2f} M samples/s, {len(several)} windows {all_of_them / 1e6:.2f} M samples/s"
    )
    assert all_of_them > one / len(several)


@pytest.mark.bench
def test_memory_of_a_stream_of_ten_million_samples_is_flat() -> None:
    early, grown = bench_scale.growth_mb(10 * MILLION)
    print(f"\nafter 1 million samples {early:.0f} MB, after 10 million {grown:+.1f} MB")
    assert grown < 10.0


@pytest.mark.soak
def test_memory_of_a_stream_of_a_hundred_million_samples_is_flat() -> None:
    early, grown = bench_scale.growth_mb(100 * MILLION)
    print(f"\nafter 10 million samples {early:.0f} MB, after 100 million {grown:+.1f} MB")
    assert grown < 10.0
