"""The filters' state on its way from hop to hop, the same to the last bit however many hops are taken at once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.window.products import row_products

FloatArray = NDArray[np.float64]
GROUP = 8
"""Hops that advance from zero side by side before groups are joined one after the other."""


@dataclass(frozen=True, slots=True)
class Course:
    """Where the state stands: groups of GROUP hops are counted from the sample at which the course began.

    Attributes:
        start: (nz,) state at the beginning of the group.
        gained: (nz,) what the group's hops so far would leave when started from zero.
        phase: number of those hops.
    """

    start: FloatArray
    gained: FloatArray
    phase: int = 0

    @classmethod
    def at(cls, z: FloatArray) -> "Course":
        """Return a course that begins at state z (nz,)."""
        return cls(z, np.zeros_like(z))

    def over(self, transition: FloatArray, forced: FloatArray) -> "tuple[FloatArray, Course]":
        """Solve z(j+1) = transition z(j) + forced(j) over N hops; return z(0..N-1), (N, nz), and the course after."""
        total, nz = self.phase + len(forced), len(self.start)
        groups = -(-total // GROUP)
        inputs = np.zeros((groups * GROUP, nz))
        inputs[self.phase : total] = forced
        gained = self._gained(transition, inputs.reshape(groups, GROUP, nz))
        starts = self._starts(transition, gained[-1])
        states = np.empty((groups, GROUP, nz))
        carried = starts[:groups]
        for j in range(GROUP):
            states[:, j] = carried + gained[j]
            carried = row_products(carried, transition.T)
        full, phase = divmod(total, GROUP)
        after = Course(starts[full], gained[phase, full] if phase else np.zeros(nz), phase)
        return states.reshape(-1, nz)[self.phase : total], after

    def _gained(self, transition: FloatArray, inputs: FloatArray) -> FloatArray:
        """Return what 0..GROUP hops of each group leave when it starts from zero, (GROUP+1, groups, nz)."""
        gained = np.zeros((GROUP + 1, *inputs[:, 0].shape))
        for j in range(GROUP):
            if j == self.phase and len(inputs):
                gained[j, 0] = self.gained
            gained[j + 1] = row_products(gained[j], transition.T) + inputs[:, j]
        return gained

    def _starts(self, transition: FloatArray, gained: FloatArray) -> FloatArray:
        """Return the state at the beginning of each group and after the last, (groups+1, nz)."""
        over_group = np.linalg.matrix_power(transition, GROUP)
        starts = np.empty((len(gained) + 1, len(self.start)))
        starts[0] = self.start
        for number, one in enumerate(gained):
            starts[number + 1] = over_group @ starts[number] + one
        return starts
