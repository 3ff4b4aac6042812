"""What a model that does not fit lacks: a score test of suspects that are not estimated.

A suspect is a force of known shape between two nodes: the sign of their velocity (dry friction), the cube of their
displacement (a spring that is not straight), a constant (an offset); or a mass that is not what the model has. Each is
one more column beside a window's sensitivities; the one that explains most of what the fit leaves is named when it
explains a large share.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from agent.numerics.fitting.fit import linearise
from agent.numerics.model.friction import MotionFilter, motion, motion_filter, signs
from agent.numerics.model.mechanics import GROUND, Element, MassSpringDamper
from agent.numerics.model.observer import Gain
from agent.numerics.model.sensors import SensedModel
from agent.numerics.model.statespace import Hold, Model, discretise
from agent.numerics.preprocessing.bridge import Bridge
from agent.types import Reason

FloatArray = NDArray[np.float64]

SHARE = 0.3
"""Least share of the residual's sum of squares that a suspect must explain to be named."""
EVIDENCE = 30.0
"""Least ratio of what it explains to what a column of no meaning would."""
NOBODY = -1
"""No channel."""


@dataclass(frozen=True, slots=True)
class Suspect:
    """A force of one shape between two nodes; inertia acts between a mass and the ground."""

    reason: Reason
    between: tuple[str, str]

    @property
    def at_fault(self) -> int:
        """No channel is."""
        return NOBODY


@dataclass(frozen=True, slots=True)
class ChannelSuspect:
    """Channels that are wrong in one way, numbers among outputs, then inputs.

    Attributes:
        kind: "bias", "gain", "input gain", "sign", "swap", "delay" or "stuck"; "forces" for none of them: what only
            unknown forces as large as the measured ones would explain.
        channels: those concerned; with "forces" the measured inputs where none of them ever moves.
    """

    kind: str
    channels: tuple[int, ...] = ()

    @property
    def reason(self) -> Reason:
        """What estimates are not valid for."""
        special = {"bias": Reason.BIAS, "forces": Reason.MISMATCH, "stuck": Reason.STUCK}
        return special.get(self.kind, Reason.SENSOR)

    @property
    def at_fault(self) -> int:
        """The channel whose sensor is at fault for certain; what else is wrong may be the configuration's."""
        return self.channels[0] if self.kind == "stuck" else NOBODY


def mass_suspect(name: str) -> Suspect:
    """Return the suspect that a mass is wrong."""
    return Suspect(Reason.MASS, (name, GROUND))


@dataclass(frozen=True, slots=True)
class Accusation:
    """The suspect that explains most of a residual.

    Attributes:
        suspect: who.
        share: of the residual's sum of squares that it explains.
        change: of a mass, over what the model has, less one; 0 for others.
        sizes: of each channel of a `ChannelSuspect`: offset (SI), gain, delay (s), where it is stuck (SI);
            share of the motion of "forces", where that is known.
    """

    suspect: Suspect | ChannelSuspect
    share: float
    change: float = 0.0
    sizes: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Suspects:
    """The suspects of one rig and how their columns are made.

    Attributes:
        suspects: k of them, the masses last.
        model: the rig's model with the suspects as further parameters: friction elements of 0 N, and masses.
        masses: (k,) what the model has of each mass; 0 for the other suspects.
        given: inputs of the rig's own model that are measured or signs, without the constant.
        forces: the first of them, which are measured.
        velocities, displacements: of the suspects' nodes.
        period_s, hold: of the sampled model.
    """

    suspects: tuple[Suspect, ...]
    model: Model
    masses: FloatArray
    given: int
    forces: int
    velocities: MotionFilter
    displacements: MotionFilter
    period_s: float
    hold: Hold

    def accuse(
        self, theta: FloatArray, gain: Gain, v: FloatArray, dof: float, bridge: Bridge | None = None, *,
        least: float = SHARE,
    ) -> Accusation | None:  # fmt: skip
        """Name the suspect that a window gives away; None where no one explains enough.

        Args:
            theta: (q,) where the rig's model is linearised.
            gain: of the observer.
            v: (W, p+m) outputs and inputs.
            dof: effective degrees of freedom of the residual.
            bridge: what the window lacks.
            least: share of the residual's sum of squares that a suspect must explain.
        """
        p, k = gain.L.shape[1], len(self.suspects)
        y, u, constant = v[:, :p], v[:, p : p + self.given], v[:, p + self.given :]
        columns = np.hstack([y, u, self._columns(y, u[:, : self.forces]), constant])
        own = self._own(k)
        full = np.insert(theta, own, self.masses)
        sampled = discretise(self.model.continuous(full), self.period_s, self.hold).model
        here = linearise(sampled, gain, columns, np.zeros(sampled.n), bridge)
        tested = np.zeros(len(full), dtype=bool)
        tested[own : own + k] = True
        found = self._worst(here.e, here.psi[:, ~tested], here.psi[:, tested], dof)
        return None if found is None or found.share < least else found

    def _own(self, k: int) -> int:
        """Parameters of the rig's model that are neither suspects nor sensor constants; they stand first."""
        inner = self.model.model if isinstance(self.model, SensedModel) else self.model
        return len(inner.parameters) - k

    def _columns(self, y: FloatArray, u: FloatArray) -> FloatArray:
        """Return the suspects' forces (W, k), each with an rms of about one."""
        speed, place = motion(self.velocities, y, u), motion(self.displacements, y, u)
        greatest = np.broadcast_to(np.abs(speed).max(axis=0), speed.shape)
        shapes = {
            Reason.DRY_FRICTION: signs(speed, self.velocities.noise, greatest),
            Reason.NONLINEAR: place**3,
            Reason.BIAS: np.ones_like(place),
        }
        forces = [suspect for suspect in self.suspects if suspect.reason in shapes]
        if not forces:
            return np.zeros((len(y), 0))
        columns = [shapes[suspect.reason][:, i] for i, suspect in enumerate(forces)]
        return np.stack([c / max(float(np.sqrt(np.mean(c**2))), 1e-300) for c in columns], axis=1)

    def _worst(self, e: FloatArray, psi: FloatArray, tested: FloatArray, dof: float) -> Accusation | None:
        basis, norms = np.linalg.qr(_unit(psi))[0], np.linalg.norm(tested, axis=0)
        left, columns = e - basis @ (basis.T @ e), _unit(tested)
        columns = columns - basis @ (basis.T @ columns)
        # a column that is nearly one of the model's own says nothing that is its own
        lengths = np.linalg.norm(columns, axis=0)
        explained = np.where(lengths > 1e-3, columns.T @ left / np.maximum(lengths, 1e-3), 0.0) ** 2
        share = explained / max(float(left @ left), 1e-300)
        worst = int(np.argmax(share))
        found = float(share[worst])
        if found * dof < EVIDENCE * (1.0 - found):
            return None
        if not self.masses[worst]:
            return Accusation(self.suspects[worst], found)
        step = float(columns[:, worst] @ left) / (lengths[worst] ** 2 * norms[worst])
        return Accusation(self.suspects[worst], found, step / float(self.masses[worst]))


def _unit(columns: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(columns, axis=0)
    return np.asarray(columns / np.where(lengths > 0, lengths, 1.0))


def suspects_of(model: Model, period_s: float, hold: Hold, sigma: FloatArray) -> Suspects | None:
    """Return the suspects of a rig of masses, springs and dampers; None for any other model.

    sigma (p,) is the standard deviation of each output's noise, NaN where it is not known.
    """
    inner = model.model if isinstance(model, SensedModel) else model
    if not isinstance(inner, MassSpringDamper):
        return None
    forcing, masses = tuple(_forces(inner)), tuple(_masses(inner))
    names = tuple(f"suspect {i}" for i in range(len(forcing)))
    added = tuple(Element(name, s.between, 0.0) for name, s in zip(names, forcing, strict=True))
    structure = replace(inner.structure, frictions=inner.structure.frictions + added)
    named = inner.parameters + names + tuple(s.between[0] for s in masses)
    suspected: Model = replace(inner, structure=structure, parameters=named)
    if isinstance(model, SensedModel):
        suspected = replace(model, model=suspected)
    values = {m.name: m.value for m in inner.structure.masses}
    known = np.array([0.0] * len(forcing) + [values[s.between[0]] for s in masses])
    pairs = [s.between for s in forcing]
    speed = motion_filter(inner, pairs, period_s, hold, sigma)
    place = motion_filter(inner, pairs, period_s, hold, sigma, displacements=True)
    forces = len(inner.forces)
    given = forces + len(inner.structure.frictions)
    return Suspects((*forcing, *masses), suspected, known, given, forces, speed, place, period_s, hold)


def _masses(model: MassSpringDamper) -> Iterator[Suspect]:
    """Every mass that is taken as known where a force is measured: in free decay all of them are a matter of scale."""
    for mass in model.structure.masses if model.forces else ():
        if mass.value > 0 and mass.name not in model.parameters:
            yield mass_suspect(mass.name)


def _forces(model: MassSpringDamper) -> Iterator[Suspect]:
    """Dry friction beside every damper and spring that has none, cubes beside springs, an offset on every mass."""
    s = model.structure
    rubbing = {frozenset(e.between) for e in s.frictions}
    for pair in dict.fromkeys(frozenset(e.between) for e in (*s.dampers, *s.springs)):
        if pair not in rubbing:
            yield Suspect(Reason.DRY_FRICTION, _ordered(pair))
    for pair in dict.fromkeys(frozenset(e.between) for e in s.springs):
        yield Suspect(Reason.NONLINEAR, _ordered(pair))
    for mass in s.masses:
        yield Suspect(Reason.BIAS, (mass.name, GROUND))


def _ordered(pair: frozenset[str]) -> tuple[str, str]:
    """The two nodes by name, ground last."""
    first, second = sorted(pair, key=lambda node: (node == GROUND, node))
    return first, second
