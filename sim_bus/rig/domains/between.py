"""What a rig of inputs and outputs, whatever its equations come from, is to what plays it."""

from dataclasses import dataclass

from sim_bus.arrays import FloatArray


@dataclass(frozen=True)
class Between:
    """A rig between its channels.

    Attributes:
        inputs, outputs: names of the channels.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    @property
    def nodes(self) -> tuple[str, ...]:
        """Where a force of a scenario may act: the inputs."""
        return self.inputs

    @property
    def massless(self) -> frozenset[str]:
        """Nodes without inertia: there are no nodes."""
        return frozenset()


@dataclass(frozen=True)
class LinearMotion:
    """x' = F x + G u with what its outputs read, for one set of parameters."""

    system: Between
    F: FloatArray
    G: FloatArray
    C: FloatArray
    D: FloatArray
    is_sampled: bool = False

    def node(self, name: str) -> int:
        """Return an input's number."""
        return self.system.inputs.index(name)

    def output(self, _quantity: str, name: str) -> tuple[FloatArray, FloatArray]:
        """Return the rows (h, j) with reading = h x + j u of an output channel."""
        number = self.system.outputs.index(name)
        return self.C[number], self.D[number]
