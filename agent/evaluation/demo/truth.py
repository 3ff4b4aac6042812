"""What the device played, and how far the agent's estimates were from it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from agent.blocks.rig_model import RigModel, hop_plan, rig_model
from agent.commissioning.numerics.information import bound_sd, window_information
from agent.config import RigConfig
from agent.numerics.model.holds import straight
from agent.numerics.model.statespace import discretise
from agent.runtime.sources import wire_steps
from agent.types import FloatArray

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Truth:
    """What was played: forces (n, nodes), states (n, s), parameters (n, k) by name, noise sd by channel."""

    forces: Mapping[str, FloatArray]
    states: Mapping[str, FloatArray]
    parameters: Mapping[str, FloatArray]
    noise_sd: Mapping[str, float]
    samples: int


def read_truth(path: Path) -> Truth:
    """Read the file that `deltak sim --truth` wrote."""
    with np.load(path) as file:
        ledger = json.loads(str(file["ledger"]))

        def named(columns: str, names: str) -> dict[str, FloatArray]:
            return {str(name): file[columns][:, i] for i, name in enumerate(file[names])}

        return Truth(
            named("forces", "node_names"), named("states", "state_names"),
            named("parameters", "parameter_names"),
            {name: float(sensor["noise_sd"]) for name, sensor in ledger["sensors"].items()},
            len(file["index"]),
        )  # fmt: skip


def segments(config: RigConfig, truth: Truth, rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return each stretch of constant parameters with its last estimates beside the truth and the bound."""
    rate = config.rig.sample_rate_hz
    edges = _edges(config, truth)
    index = [_sample(config, rows, row["t_ns"]) for row in rows]
    found = []
    for start, stop in pairwise(edges):
        last = max((i for i in index if start <= i < stop), default=None)
        chosen = {r["parameter"]: r for r, i in zip(rows, index, strict=True) if i == last}
        bounds = _bounds(config, truth, last) if last is not None else {}
        parameters = {
            name: _assessed(name, truth, stop - 1, chosen.get(name, {}), bounds) for name in _names(config)
        }
        found.append({"from_s": start / rate, "to_s": stop / rate, "parameters": parameters})
    return found


def _names(config: RigConfig) -> tuple[str, ...]:
    return config.estimator.estimate


def _edges(config: RigConfig, truth: Truth) -> list[int]:
    """Sample numbers at which some parameter takes a new value, with both ends."""
    values = np.column_stack([truth.parameters[name] for name in _names(config)])
    changes = np.flatnonzero(np.any(np.diff(values, axis=0) != 0, axis=1)) + 1
    return [0, *changes.tolist(), truth.samples]


def _assessed(name: str, truth: Truth, at: int, row: Row, bounds: Mapping[str, float]) -> dict[str, Any]:
    true = float(truth.parameters[name][at])
    value = row.get("value")
    sd = row.get("sd")
    error = (value - true) / sd if value is not None and sd else None
    return {"true": true, "estimate": value, "sd": sd, "bound_sd": bounds.get(name), "error_sd": error,
            "status": row.get("status")}  # fmt: skip


def _bounds(config: RigConfig, truth: Truth, last: int) -> dict[str, float]:
    """The Cramer-Rao bound of the window that ends at sample `last`, for the noise and rounding played."""
    plan = hop_plan(config)
    rig = rig_model(config)
    start = last + 1 - plan.window
    if start < 0:
        return {}
    theta = np.array([truth.parameters[name][start] for name in _names(config)])
    hold = straight(config.estimator.hold)
    discrete = discretise(rig.model.continuous(theta), 1.0 / config.rig.sample_rate_hz, hold)
    x0 = np.array([truth.states[name][start] for name in _state_columns(rig)])
    u = np.column_stack([truth.forces[c.at or c.name][start : last + 1] for c in config.inputs])
    information = window_information(discrete, x0, u, _sigma(config, truth))
    return dict(zip(_names(config), bound_sd(information).tolist(), strict=True))


def _state_columns(rig: RigModel) -> list[str]:
    return [
        name.replace("velocity of ", "v.").replace("displacement of ", "q.") for name in rig.model.state_names
    ]


def _sigma(config: RigConfig, truth: Truth) -> FloatArray:
    steps = wire_steps(config)
    noise = [truth.noise_sd.get(c.name, 0.0) * c.si_factor for c in config.outputs]
    rounding = [steps.get(c.name, 0.0) * abs(c.scale) * c.si_factor / np.sqrt(12) for c in config.outputs]
    return np.hypot(noise, rounding)


def alarm_delays(
    config: RigConfig, truth: Truth, rows: Sequence[Row], alarms: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Return, for each change that carries a parameter beyond its limit, when it was alarmed."""
    limits = dict(zip(_names(config), rig_model(config).limits.tolist(), strict=True))
    raised = [(a["parameter"], _sample(config, rows, a["raised_ns"])) for a in alarms if a["kind"] == "level"]
    found = []
    for start in _edges(config, truth)[:-1]:
        for name in _names(config):
            change = np.abs(truth.parameters[name] - config.parameters[name].nominal)
            if change[start] > limits[name] and not (start and change[start - 1] > limits[name]):
                after = min((i for parameter, i in raised if parameter == name and i >= start), default=None)
                found.append(_delay(name, start, after, config.rig.sample_rate_hz))
    return found


def _sample(config: RigConfig, rows: Sequence[Row], t_ns: int) -> int:
    """Sample number of a time stamp: the run's first row falls due at the end of the first hop's head."""
    first: int = min(row["t_ns"] for row in rows)
    return hop_plan(config).head - 1 + round((t_ns - first) * config.rig.sample_rate_hz / 1e9)


def _delay(name: str, changed: int, raised: int | None, rate_hz: float) -> dict[str, Any]:
    return {
        "parameter": name,
        "changed_s": changed / rate_hz,
        "raised_s": None if raised is None else raised / rate_hz,
        "delay_s": None if raised is None else (raised - changed) / rate_hz,
    }
