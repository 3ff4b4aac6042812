"""Parameters over time, exact to the sample."""

import numpy as np

from sim_bus.rig.schedule import Change, Draw, Timeline, first_sample

NOMINAL = {"k1": 25.0, "B1": 5.0}


def test_timeline_change_at_a_sample_governs_from_that_sample_on() -> None:
    line = Timeline(NOMINAL, [Change(at_s=1.0, delta={"k1": 10.0})], 1000.0)
    assert line.values(999) == NOMINAL
    assert line.values(1000) == {"k1": 35.0, "B1": 5.0}
    assert list(line.segments(0, 1500)) == [(0, 1000, NOMINAL), (1000, 1500, {"k1": 35.0, "B1": 5.0})]


def test_first_sample_between_two_samples_is_the_later() -> None:
    assert [first_sample(t, 1000.0) for t in (0.0, 0.0004, 0.001, 0.0011, 0.3, 0.7)] == [0, 1, 1, 2, 300, 700]


def test_timeline_deltas_count_from_nominal_and_others_stay() -> None:
    changes = [
        Change(at_s=0.0, delta={"k1": 5.0}),
        Change(at_s=0.5, percent={"B1": -20.0}),
        Change(at_s=0.6, value={"k1": 7.0}),
    ]
    line = Timeline(NOMINAL, changes, 10.0)
    assert [line.values(i) for i in (0, 5, 6)] == [
        {"k1": 30.0, "B1": 5.0},
        {"k1": 30.0, "B1": 4.0},
        {"k1": 7.0, "B1": 4.0},
    ]


def test_timeline_ramp_moves_in_steps_and_arrives() -> None:
    line = Timeline(NOMINAL, [Change(at_s=1.0, delta={"k1": 10.0}, ramp_s=1.0, every_s=0.25)], 100.0)
    assert [line.values(i)["k1"] for i in (99, 100, 124, 125, 150, 199, 200, 5000)] == [
        25.0, 25.0, 25.0, 27.5, 30.0, 32.5, 35.0, 35.0,
    ]  # fmt: skip
    assert [(first, end) for first, end, _ in line.segments(90, 230)] == [
        (90, 100), (100, 125), (125, 150), (150, 175), (175, 200), (200, 230),
    ]  # fmt: skip


def test_timeline_segments_any_cut_gives_the_same_values() -> None:
    changes = [
        Change(at_s=0.03, delta={"k1": 5.0}, ramp_s=0.05),
        Change(at_s=0.06, delta={"k1": -5.0, "B1": 1.0}),
    ]
    line = Timeline(NOMINAL, changes, 1000.0)
    whole = [values["k1"] for first, end, values in line.segments(0, 100) for _ in range(first, end)]
    pieces = [
        v["k1"]
        for a in range(0, 100, 7)
        for f, e, v in line.segments(a, min(a + 7, 100))
        for _ in range(f, e)
    ]
    assert whole == pieces == [line.values(i)["k1"] for i in range(100)]


def test_draw_same_seed_gives_the_same_schedule_and_keeps_its_ranges() -> None:
    draw = Draw(segments=50, keep=0.4, delta={"k1": [(20.0, 50.0)], "B1": [(-4.0, -2.8), (2.8, 5.0)]})
    assert draw.changes(7) == draw.changes(7)
    assert draw.changes(7) != draw.changes(8)
    moved = np.array([[change.delta["k1"], change.delta["B1"]] for change in draw.changes(7)])
    assert 0.2 < np.mean(moved == 0.0) < 0.6
    k1, b1 = moved[moved[:, 0] != 0, 0], moved[moved[:, 1] != 0, 1]
    assert k1.min() >= 20.0
    assert k1.max() <= 50.0
    assert np.all((np.abs(b1) >= 2.8) & (b1 >= -4.0) & (b1 <= 5.0))
