"""A template of a configuration as a system that the simulator plays."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict

from sim_bus.arrays import FloatArray
from sim_bus.errors import SimUsageError
from sim_bus.rig.domains import networks, swinging
from sim_bus.rig.domains.built import Built, Place, Raw, Values


class _Kind(NamedTuple):
    values: Callable[[Raw], dict[str, float]]
    build: Callable[[Raw, Values], Built]


KINDS: Mapping[str, _Kind] = {
    "rlc-ladder": _Kind(networks.ladder_values, networks.ladder),
    "dc-motor": _Kind(networks.motor_values, networks.motor),
    "voice-coil": _Kind(networks.motor_values, networks.voice_coil),
    "thermal": _Kind(networks.thermal_values, networks.thermal),
    "hydraulic": _Kind(networks.hydraulic_values, networks.hydraulic),
    "torsional": _Kind(swinging.torsional_values, swinging.torsional),
    "frame": _Kind(swinging.frame_values, swinging.frame),
}


class DomainTable(BaseModel):
    """The [model] of a template, its own keys as in the file; `deltak check` says what is wrong in them."""

    model_config = ConfigDict(extra="allow", frozen=True)

    kind: str

    @property
    def raw(self) -> dict[str, Any]:
        """All keys."""
        return {"kind": self.kind, **(self.model_extra or {})}

    @property
    def nominal(self) -> dict[str, float]:
        """Every element by name."""
        return {
            name: float(value)
            for name, value in self._tried(lambda: KINDS[self.kind].values(self.raw)).items()
        }

    def built(self, values: Values) -> Built:
        """Return the motion for one set of elements."""
        built: Built = self._tried(lambda: KINDS[self.kind].build(self.raw, values))
        return built

    def _tried(self, make: Callable[[], Any]) -> Any:
        try:
            return make()
        except (
            KeyError,
            TypeError,
            ValueError,
            AttributeError,
            ZeroDivisionError,
            np.linalg.LinAlgError,
        ) as error:
            what = f"model: no {self.kind} stands there ({error}); deltak check says what to do"
            raise SimUsageError(what) from error


@dataclass(frozen=True)
class DomainSystem:
    """A template's rig between its channels.

    Attributes:
        table: the template.
        inputs, outputs: names of the channels.
        places: where each of them is, inputs first.
    """

    table: DomainTable
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    places: tuple[Place, ...]

    @property
    def nodes(self) -> tuple[str, ...]:
        """Where a force of a scenario may act: the inputs."""
        return self.inputs

    @property
    def massless(self) -> frozenset[str]:
        """Nodes without inertia: there are no nodes."""
        return frozenset()

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """The names of the states."""
        return self.table.built(self.nominal).states

    @cached_property
    def nominal(self) -> dict[str, float]:
        """Every element by name: any of them may change."""
        return self.table.nominal

    def equations(self, values: Values) -> "DomainMotion":
        """Return the motion for one set of elements."""
        built = self.table.built(values)
        n, m, p = len(built.F), len(self.inputs), len(self.outputs)
        G = np.array([built.drives[place] for place in self.places[:m]]).T.reshape(n, m)  # noqa: N806 - a letter
        C = np.array([built.reads[place] for place in self.places[m:]]).reshape(p, n)  # noqa: N806 - a letter
        return DomainMotion(self, built.F, G, C)


@dataclass(frozen=True)
class DomainMotion:
    """x' = F x + G u with what its outputs read, for one set of elements."""

    system: DomainSystem
    F: FloatArray
    G: FloatArray
    C: FloatArray

    @property
    def is_sampled(self) -> bool:
        """Whether F x + G u is the next state: never."""
        return False

    def node(self, name: str) -> int:
        """Return an input's number."""
        return self.system.inputs.index(name)

    def output(self, _quantity: str, name: str) -> tuple[FloatArray, FloatArray]:
        """Return the rows (h, j) with reading = h x + j u of an output channel."""
        return self.C[self.system.outputs.index(name)], np.zeros(len(self.system.inputs))
