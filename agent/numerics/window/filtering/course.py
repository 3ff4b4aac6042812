"""The filters' state from hop to hop, the same to the last bit however many hops are taken at once."""

from dataclasses import dataclass

import numpy as np

from agent.numerics.window.filtering.products import row_products
from agent.numerics.window.filtering.transition import Transition
from agent.numerics.window.tuning import GROUP
from agent.types import FloatArray


def powers_of(over_hop: Transition) -> FloatArray:
    """Return the transposed powers 0..GROUP of a transition over a hop, (GROUP+1, nz, nz)."""
    powers = [over_hop.power(0)]
    for _ in range(GROUP):
        powers.append(over_hop.after(powers[-1]))
    return np.stack([np.ascontiguousarray(power.whole().T) for power in powers])


@dataclass(frozen=True, slots=True)
class Course:
    """Where the state stands: groups of GROUP hops are counted from the sample at which the course began.

    Attributes:
        start: (nz,) state at the beginning of the group.
        gained: (nz,) what the group's hops so far leave when started from zero.
        phase: number of those hops.
    """

    start: FloatArray
    gained: FloatArray
    phase: int = 0

    @classmethod
    def at(cls, z: FloatArray) -> "Course":
        """Return a course that begins at state z (nz,)."""
        return cls(z, np.zeros_like(z))

    def over(self, powers: FloatArray, forced: FloatArray) -> "tuple[FloatArray, Course]":
        """Solve z(j+1) = transition z(j) + forced(j) over N hops.

        Return z(0..N-1), (N, nz), and the course after.
        """
        total = self.phase + len(forced)
        nz = len(self.start)
        groups = -(-total // GROUP)
        inputs = np.zeros((groups * GROUP, nz))
        inputs[self.phase : total] = forced
        phases = range(self.phase, total) if groups == 1 else range(GROUP)  # all that are of use
        gained = self._gained(powers[1], inputs.reshape(groups, GROUP, nz), phases)
        full, phase = divmod(total, GROUP)
        starts = self._starts(powers[GROUP].T, gained[GROUP, :full])
        states = np.empty((groups, GROUP, nz))
        for j in phases:
            states[:, j] = row_products(starts[:groups], powers[j]) + gained[j]
        after = Course(starts[full], gained[phase, full] if phase else np.zeros(nz), phase)
        return states.reshape(-1, nz)[self.phase : total], after

    def _gained(self, step: FloatArray, inputs: FloatArray, phases: range) -> FloatArray:
        """Return what 0..GROUP hops of each group leave when it starts from zero, (GROUP+1, groups, nz)."""
        gained = np.zeros((GROUP + 1, *inputs[:, 0].shape))
        for j in phases:
            if j == self.phase:
                gained[j, 0] = self.gained
            gained[j + 1] = row_products(gained[j], step) + inputs[:, j]
        return gained

    def _starts(self, over_group: FloatArray, gained: FloatArray) -> FloatArray:
        """Return the state at the beginning of each group and after the last full one, (full+1, nz)."""
        starts = np.empty((len(gained) + 1, len(self.start)))
        starts[0] = self.start
        for number, one in enumerate(gained):
            starts[number + 1] = over_group.dot(starts[number]) + one
        return starts
