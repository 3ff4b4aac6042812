"""A rig that stands still says so, holds what it knew, and raises nothing; moving again it knows again."""

import numpy as np
import pytest

from agent.runtime.replay import make_pipeline
from agent.types import AlarmTransition, EstimateBatch, FloatArray, Reason, Status
from tests.statistical.detection import records
from tests.statistical.machine import NOMINAL, SECOND, Machine, configuration, fresh, on_second
from tests.statistical.operation import NOISE_M, drive

STOP, STILL, MOVES, END = 8 * SECOND, 38 * SECOND, 40 * SECOND, 44 * SECOND
"""The force stops; by then the motion has died out; the force is back; the end."""


def played() -> FloatArray:
    """Force and displacements: at work, at a standstill, at work."""
    rng = np.random.default_rng(3)
    force = np.concatenate([drive(rng, STOP), np.zeros(MOVES - STOP), drive(rng, END - MOVES + 1)])
    y = Machine.at_rest().play(on_second(force))[:, :2]
    return np.column_stack([force[:-1], y + NOISE_M * rng.standard_normal(y.shape)])


@pytest.mark.parametrize("noise_sd", [NOISE_M, None], ids=["stated noise", "learnt noise"])
def test_standstill_holds_what_was_known_and_says_why(noise_sd: float | None) -> None:
    pipe = fresh(("standstill", noise_sd), lambda: make_pipeline(configuration(noise_sd)))
    found = records(pipe, played())
    batches = [record for record in found if isinstance(record, EstimateBatch)]
    index, status, reason, held = (
        np.concatenate([getattr(batch, part) for batch in batches])
        for part in ("index", "status", "reason", "held")
    )
    still = (index >= STILL) & (index < MOVES)
    assert (status[still] == Status.UNEXCITED).all()
    assert (reason[still] == Reason.STANDSTILL).all()
    np.testing.assert_allclose(held[still], np.broadcast_to(NOMINAL, held[still].shape), rtol=0.1)
    assert not (reason[index < STOP + SECOND] == Reason.STANDSTILL).any()
    again = index >= MOVES + 2 * SECOND
    # a window in which the load happens to excite a damper little may say so
    assert np.isin(status[again], (Status.VALID, Status.UNEXCITED)).all()
    assert (status[again] == Status.VALID).mean() >= 0.98
    assert not (reason[again] == Reason.STANDSTILL).any()
    assert not [record for record in found if isinstance(record, AlarmTransition)]


GRAIN_M = 1e-5
"""Steps of encoders, which have no noise."""


def held_fast(seed: int) -> FloatArray:
    """Force and displacements: at work to `STOP`, held where the masses are for 5 s, let go with no force."""
    rng = np.random.default_rng(seed)
    force, rest = drive(rng, STOP), 5 * SECOND
    machine = Machine.at_rest()
    before = machine.play(on_second(np.append(force, 0.0)))[:, :2]
    held = np.repeat(before[-1:], rest, axis=0)
    machine.state[2:] = 0.0
    after = machine.play(np.zeros((SECOND + 1, 2)))[:, :2]
    y = np.round(np.vstack([before, held, after]) / GRAIN_M) * GRAIN_M
    return np.column_stack([np.concatenate([force, np.zeros(rest + SECOND)]), y])


def test_windows_in_which_something_holds_the_masses_for_most_of_the_time_say_so() -> None:
    """Where they are held their springs would move them: as if these were gone."""
    pipe = fresh("held fast", lambda: make_pipeline(configuration(None)))
    batches = [r for r in records(pipe, held_fast(3)) if isinstance(r, EstimateBatch)]
    index, status, reason = (
        np.concatenate([getattr(batch, part) for batch in batches]) for part in ("index", "status", "reason")
    )
    mostly = (index >= STOP + 0.65 * SECOND) & (index < STOP + 5.35 * SECOND)
    assert (status[mostly] == Status.UNEXCITED).all()
    assert (reason[mostly] == Reason.STANDSTILL).all()
    assert (status[index < STOP] == Status.VALID)[20:].mean() >= 0.95
