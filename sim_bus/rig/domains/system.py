"""A template of a configuration as a system that the simulator plays."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict

from sim_bus.errors import SimUsageError
from sim_bus.rig.domains import networks, swinging
from sim_bus.rig.domains.built import Between, Built, LinearMotion, Place, Raw, Values


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
class DomainSystem(Between):
    """A template's rig.

    Attributes:
        table: the template.
        places: where each channel is, inputs first.
    """

    table: DomainTable
    places: tuple[Place, ...]

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """The names of the states."""
        return self.table.built(self.nominal).states

    @cached_property
    def nominal(self) -> dict[str, float]:
        """Every element by name: any of them may change."""
        return self.table.nominal

    def equations(self, values: Values) -> LinearMotion:
        """Return the motion for one set of elements."""
        built = self.table.built(values)
        n, m, p = len(built.F), len(self.inputs), len(self.outputs)
        G = np.array([built.drives[place] for place in self.places[:m]]).T.reshape(n, m)  # noqa: N806 - a letter
        C = np.array([built.reads[place] for place in self.places[m:]]).reshape(p, n)  # noqa: N806 - a letter
        return LinearMotion(self, built.F, G, C, np.zeros((p, m)))
