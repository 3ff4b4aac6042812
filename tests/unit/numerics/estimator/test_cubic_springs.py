"""Springs that harden: how much one window says, rows of the bank, memory, and what is worth a word."""

import json
from dataclasses import replace

import numpy as np
import pytest

from agent.blocks.statistical_rig import estimator_settings, statistical_rig
from agent.numerics.estimator.look_ahead import LookAhead
from agent.numerics.estimator.memory import from_text, to_text
from agent.numerics.estimator.operating_point import operating_point, taps_of
from agent.numerics.estimator.reading import read
from agent.numerics.estimator.record import Record
from agent.numerics.inference.constants import Constants
from agent.numerics.inference.learner import Learner
from agent.numerics.inference.posterior import Knowledge
from agent.numerics.inference.spectral.columns import Window
from agent.numerics.inference.verdicts import beliefs
from agent.numerics.model.uncertain import Rig
from agent.numerics.window.stream import Stream
from tests.statistical.chains import DRIVEN, FELT, THREE, TWO, Chain
from tests.statistical.hardening import motion
from tests.unit.numerics.window.bank_rigs import due, joined

SHARE = 0.03
SAMPLES = 4000


def rig_of(chain: Chain) -> Rig:
    return estimator_settings(chain.configuration(), np.zeros(len(chain.sensors))).rig


def learner_of(rig: Rig) -> Learner:
    return Learner(rig, TWO.window, 2, np.zeros(2))


def played(seed: int, shares: tuple[float, ...]) -> tuple[Record, np.ndarray]:
    """Samples of TWO with springs that harden, as the estimator keeps them, and their extensions' ms (2,)."""
    rng = np.random.default_rng(seed)
    forces = np.zeros((SAMPLES, 2))
    forces[:, 1] = TWO.force(rng, SAMPLES)
    y = motion(TWO, forces, shares)
    straight = TWO.motion(forces)
    record = Record(0, 2, 3)
    y = y + np.array(TWO.noise) * rng.standard_normal(y.shape)
    ready = LookAhead(rig_of(TWO)).step(0, y, forces[:, 1:], None, None)
    record.append(ready.y, ready.u, None)
    return record, (np.diff(straight, axis=1, prepend=0.0) ** 2).mean(axis=0)


def only(constants: Constants, name: str) -> Constants:
    """One hypothesis of the sum, believed."""
    first = [h.name for h in constants.hypotheses].index(name)
    one = slice(first, first + 1)
    return Constants(constants.hypotheses[one], np.ones(1), constants.mean[one], constants.covariance[one])


def known_of(learner: Learner, name: str) -> Knowledge:
    known = learner.prior(np.array(TWO.noise), np.full(2, 0.3))
    return replace(known, constants=only(known.constants, name))


def learnt(learner: Learner, window: Window, name: str) -> Knowledge:
    return learner.learn(window, known_of(learner, name))[1]


@pytest.mark.parametrize("spring", [0, 1])
def test_by_how_much_a_spring_hardens_is_found_in_one_window(spring: int) -> None:
    shares = (SHARE, 0.0) if spring == 0 else (0.0, 3 * SHARE)
    record, usual = played(5, shares)
    rig = rig_of(TWO)
    after = learnt(learner_of(rig), record.window(SAMPLES - 1, TWO.window), f"k{spring + 1} cubic")
    assert after.stretch is not None
    number = int(rig.of_kind("cubic")[spring])
    wanted = shares[spring] * after.stretch[spring] / usual[spring]
    sd = float(np.sqrt(after.constants.total[number, number]))
    assert sd < 0.2 * wanted
    assert after.constants.expected[number] == pytest.approx(wanted, abs=3 * sd)


@pytest.mark.parametrize("name", ["k1 cubic", "k1 cubic and k2 cubic"])
def test_bank_rows_of_springs_that_harden_are_the_learners_windows(name: str) -> None:
    record, usual = played(6, (SHARE, SHARE if "k2" in name else 0.0))
    rig = rig_of(TWO)
    learner = learner_of(rig)
    settings = estimator_settings(TWO.configuration(), np.zeros(2))
    # where it hardens as much as it does: what both forms share is the likelihood about that point
    first = record.window(SAMPLES // 2 - 1, TWO.window)
    known = learner.lineariser.prepared(first, known_of(learner, name))
    assert known.stretch is not None
    mean = known.constants.mean.copy()
    mean[0, rig.of_kind("cubic")] = SHARE * known.stretch / usual * [1.0, "k2" in name]
    known = replace(known, constants=replace(known.constants, mean=mean), eta=mean[0])
    known = replace(known, noise=replace(known.noise, windows=1), kept=TWO.window // 2 + 1)
    at = learner.lineariser.linearised(first, known, jumps=False)
    posterior = learner._posterior(at, known)
    known = replace(known, footing=learner.moved_to(at, known, same=False).footing, theta=at.theta)
    point = operating_point(rig, known, posterior, learner.sources, TWO.window, posterior.sd_repeat)
    assert point.inputs == 3
    point = replace(point, slid=np.zeros(rig.q))
    taps = taps_of(rig, 2, point.inputs, point.slopes)
    stream = Stream(point.model, point.push, point.noise, settings.plan, (), rig.q, taps)
    stream.start_segment(0)
    taken = record.samples_with_slopes if point.slopes else record.samples
    stream.append(0, taken(0, SAMPLES, point.inputs))
    windowed = joined(due(stream)).windows[0]
    assert windowed is not None
    rows = read(windowed, point, TWO.window)
    # as rows are read: constants as they are expected, about the point
    later = replace(
        known, constants=known.constants.predicted(), theta=point.theta, eta=known.constants.expected
    )
    for i in np.flatnonzero(rows.index >= 2 * TWO.window)[::8].tolist():
        window = record.window(int(rows.index[i]), TWO.window)
        at = learner.lineariser.linearised(window, later, jumps=False, steps=1)
        said = learner._posterior(at, later)
        # rows are up to 2.5 sds from the point: what the forms differ by is of the second order
        assert np.abs((rows.theta[i] - said.theta) / said.sd).max() < 0.03
        assert np.abs(np.log(rows.sd[i] / said.sd)).max() < 0.02


def test_bank_takes_no_cube_while_springs_are_believed_to_be_straight() -> None:
    record, _ = played(7, (0.0, 0.0))
    rig = rig_of(TWO)
    learner = learner_of(rig)
    known = learner.prior(np.array(TWO.noise), np.full(2, 0.3))
    posterior, known = learner.learn(record.window(SAMPLES - 1, TWO.window), known)
    straight = operating_point(rig, known, posterior, learner.sources, TWO.window, posterior.sd_repeat)
    assert straight.inputs == 1
    assert straight.model.m == len(rig.measured[:1]) * (2 if straight.slopes else 1)


def test_cubes_are_looked_for_where_displacements_show_extensions() -> None:
    assert [c.name for c in rig_of(THREE).cubics] == ["k1", "k2", "k3"]
    assert [c.name for c in rig_of(DRIVEN).cubics] == ["k1"]
    assert not rig_of(FELT).cubics
    assert not estimator_settings(TWO.configuration(hold="cubic"), np.zeros(2)).rig.cubics
    denied = TWO.configuration(observer='[estimator.observer]\ngain = "kalman"\nprocess_sd = 0')
    assert not estimator_settings(denied, np.zeros(2)).rig.cubics


def test_cube_counts_by_the_widest_extensions_so_far_and_pushes_as_before() -> None:
    record, _ = played(5, (SHARE, 0.0))
    rig = rig_of(TWO)
    after = learnt(learner_of(rig), record.window(SAMPLES - 1, TWO.window), "k1 cubic")
    assert after.stretch is not None
    cubic = rig.of_kind("cubic")
    wider = after.stretched(after.stretch * np.array([25.0, 2.0]), cubic)
    assert wider.stretch is not None
    np.testing.assert_allclose(wider.stretch / after.stretch, [25.0, 1.0])
    number = int(cubic[0])
    np.testing.assert_allclose(
        wider.constants.mean[:, number] / wider.stretch[0], after.constants.mean[:, number] / after.stretch[0]
    )
    np.testing.assert_allclose(
        wider.constants.covariance[:, number, number], 625 * after.constants.covariance[:, number, number]
    )
    # what a cube does to the parameters stays what it was
    assert wider.footing is not None and after.footing is not None  # noqa: PT018 - a window was learnt from
    for there, here in (
        (wider.footing, after.footing),
        (wider.scatter.last[-1], after.scatter.last[-1]),
    ):
        assert np.abs(here.sensitivity[:, number]).max() > 0
        np.testing.assert_allclose(25 * there.sensitivity[:, number], here.sensitivity[:, number])
    assert wider.stretched(after.stretch, cubic) is wider
    # what is hardly known of it is no wider than before any data
    fresh = replace(known_of(learner_of(rig), "k1 cubic"), stretch=after.stretch)
    anew = fresh.stretched(100 * after.stretch, cubic)
    np.testing.assert_allclose(anew.constants.covariance, fresh.constants.covariance)


def test_memory_of_an_earlier_program_without_cubes_is_taken_up() -> None:
    record, _ = played(7, (0.0, 0.0))
    rig, before = rig_of(TWO), statistical_rig(TWO.configuration())
    window = record.window(SAMPLES - 1, TWO.window)
    old = learner_of(before)
    _, known = old.learn(
        replace(window, u=window.u[:, :1], slope=window.slope[:, :1]),
        old.prior(np.array(TWO.noise), np.full(2, 0.3)),
    )
    learner = learner_of(rig)
    fresh = learner.prior(np.array(TWO.noise), np.full(2, 0.3))
    assert from_text(to_text(known), fresh, learner.wire) is None
    taken = from_text(to_text(known), fresh, learner.wire, cubics=2)
    assert taken is not None
    count, c = len(known.constants.weight), len(known.eta)
    np.testing.assert_array_equal(taken.constants.covariance[:count, :c, :c], known.constants.covariance)
    np.testing.assert_array_equal(taken.constants.covariance[count:], fresh.constants.covariance[count:])
    np.testing.assert_array_equal(taken.eta[c:], 0.0)
    posterior, after = learner.learn(window, taken)
    assert posterior.holds
    again = from_text(to_text(after), fresh, learner.wire, cubics=2)
    assert again is not None
    np.testing.assert_array_equal(again.stretch, after.stretch)
    assert "stretch" not in json.loads(to_text(known))


def test_spring_that_hardly_hardens_is_not_worth_a_word() -> None:
    rig = rig_of(TWO)
    known = known_of(learner_of(rig), "k1 cubic and k2 cubic")
    mean = np.zeros_like(known.constants.mean)
    mean[0, rig.of_kind("cubic")] = (0.05, 0.001)
    sure = replace(known.constants, mean=mean, covariance=1e-4 * known.constants.covariance)
    said = {b.name: b for b in beliefs(sure, rig.constants, np.array([4e-4, 1e-4]))}
    assert said["k1 cubic"].probability > 0.99
    assert said["k2 cubic"].probability < 0.01
    assert said["k1 cubic"].size == pytest.approx(0.05)
    assert said["k1 cubic"].extension == pytest.approx(0.02)


def test_scales_that_no_reading_shows_tie_beside_springs_that_may_harden() -> None:
    """Masses and forces times c leave every motion as it is; cubes that are not there tell nothing of c."""
    record, _ = played(7, (0.0, 0.0))
    learner = learner_of(rig_of(TWO))
    known = learner.prior(np.array(TWO.noise), np.full(2, 0.3))
    for newest in (SAMPLES // 2 - 1, SAMPLES - 1):
        # a force that reads a twentieth less than it should
        window = record.window(newest, TWO.window)
        less = np.array([0.95, 1.0, 1.0])
        known = learner.learn(replace(window, u=window.u * less, slope=window.slope * less), known)[1]
    names = ("all masses", "all outputs", "force")
    weights = {
        h.name: w
        for h, w in zip(known.constants.hypotheses, known.constants.weight, strict=True)
        if h.level == "as configured"
    }
    found = np.array([weights[name] for name in names])
    np.testing.assert_allclose(found / found[0], 1.0, rtol=1e-4)


def test_first_window_may_refute_that_springs_harden_and_does_not_speak_for_it() -> None:
    rig = rig_of(TWO)
    cubic = rig.of_kind("cubic")
    first = learner_of(rig).prior(np.array(TWO.noise), np.full(2, 0.3)).constants
    off = np.array([any(o.members[cubic].any() for o in h.off) for h in first.hypotheses])
    refuted = replace(first, weight=np.where(off, 1e-6 * first.weight, first.weight))
    assert refuted.refused(cubic) is refuted
    spoken = replace(first, weight=np.where(off, 1.0, 1e-3) / len(off))
    found = spoken.refused(cubic)
    np.testing.assert_array_equal(found.weight[off], first.weight[off])
    assert found.weight.sum() == pytest.approx(1.0)
    # evidence beyond all doubles
    sure = replace(first, weight=off / off.sum())
    np.testing.assert_array_equal(sure.refused(cubic).weight, first.weight)
