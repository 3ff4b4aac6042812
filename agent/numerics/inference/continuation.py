"""Where a window is straight whose parameters may be anywhere: by continuation from forces that explain all.

Sought together with forces that could be all of the motion, parameters are those that leave the least error
of the equations of motion, in which they are straight: one minimum, however far modes are from where they
were. From there forces are taken away step by step (Allgower & Georg, Numerical Continuation Methods, 1990).
"""

from dataclasses import replace

import numpy as np

from agent.numerics.inference import tuning
from agent.numerics.inference.linearise import Linearised, Lineariser
from agent.numerics.inference.posterior import Knowledge, shifted
from agent.numerics.inference.spectral.algebra import inverse
from agent.numerics.inference.spectral.columns import Window
from agent.types import FloatArray


class Continuation:
    """Finds where a window is straight, by a lineariser of its rig."""

    def __init__(self, lineariser: Lineariser) -> None:
        self._lineariser = lineariser

    def of(self, window: Window, known: Knowledge) -> Knowledge:
        """Return what is known at parameters and constants where a window is straight, with bins to keep.

        As it was where constants would be off as none is: millimetres for metres are no gain.
        """
        before, own = known, known.noise
        forces = self._wholly(window, known)
        for share in tuning.CONTINUATION:
            known = replace(known, kept=self._lineariser.kept(window, replace(known, noise=own)))
            known = replace(known, noise=replace(own, intensity=np.hypot(own.intensity, share * forces)))
            at = self._at(window, known)
            for _ in range(tuning.STEPS):
                lower = self._lower(window, known, at)
                if lower is None:
                    break
                known, at = lower
        return replace(known, noise=own) if _improbable(known) < tuning.MISMATCH_SD**2 else before

    def _at(self, window: Window, known: Knowledge) -> Linearised:
        """A window at what is known, linearised with the motion that unknown forces make in it."""
        return self._lineariser.point(window, known, known.theta, np.zeros(0, dtype=np.int64), joint=True)

    def _wholly(self, window: Window, known: Knowledge) -> FloatArray:
        """Intensities (a,) at which each white force alone would be as strong as all of a motion."""
        cells, white = self._at(window, known).cells, known.noise.white
        moved = float((window.y.var(axis=0) / white).sum())
        shown = (np.abs(cells.D) ** 2 / white[:, None]).sum(axis=1)
        mean = np.maximum(cells.weight @ shown / cells.weight.sum(), 1e-300)
        fresh = [source.kind == "force" and source.pole == 0 for source in self._lineariser.sources]
        return np.where(fresh, np.sqrt(moved / mean), 0.0)

    def _lower(self, window: Window, known: Knowledge, at: Linearised) -> tuple[Knowledge, Linearised] | None:
        """What is known where the cost falls along a step of parameters and constants, and the window there.

        None at rest, if there is none, or if enough was evaluated.
        """
        lineariser, layout = self._lineariser, at.regression.layout
        _, step = at.fitted
        rests = lineariser.length(at, step[layout.psi], np.sqrt(np.diag(at.given[1]))) <= 1.0
        if rests or lineariser.evaluations >= lineariser.most:
            return None
        before = lineariser.cost(at, at.regression, given=True) + _improbable(known)
        for share in 0.5 ** np.arange(tuning.HALVINGS):
            theta = shifted(at.theta, share * at.unit * step[layout.psi])
            there = replace(
                known, theta=np.maximum(theta, lineariser.rig.lower), eta=known.eta + share * step[layout.xi]
            )
            if _improbable(there) > tuning.ASTRAY_SD**2:
                return None
            trial = self._at(window, there)
            if lineariser.cost(trial, trial.regression, given=True) + _improbable(there) < before:
                return there, trial
        return None


def _improbable(known: Knowledge) -> float:
    """Twice the negative log prior of the constants at which a window is linearised."""
    apart = known.eta - known.constants.expected
    return float(apart @ inverse(known.constants.total) @ apart) if len(apart) else 0.0
