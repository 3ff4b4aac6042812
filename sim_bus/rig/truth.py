"""The truth file: what was played, for whoever compares estimates with it. The agent never opens it."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sim_bus.rig.trajectory import Chunk, Rig


class TruthRecorder:
    """Keeps every chunk that is made, and writes those samples that were played.

    The file is an NPZ with, for n samples: index, t_s (n,); forces (n, nodes) N; states (n, states) SI;
    parameters (n, parameters), the values that govern the interval that begins at each sample; true (n,
    channels) what ideal sensors would read, SI; readings (n, channels) in the channels' units; covariates (n,
    covariates) as read, in their units; the names of the columns in node_names, state_names, parameter_names,
    channel_names, covariate_names; the ledger as JSON text in ledger.
    """

    def __init__(self, rig: Rig, sample_rate_hz: float) -> None:
        self._rig = rig
        self._rate = sample_rate_hz
        self._chunks: list[Chunk] = []

    def keep(self, chunk: Chunk) -> None:
        """Keep a chunk."""
        self._chunks.append(chunk)

    def arrays(self, played: int, ledger: Mapping[str, Any]) -> dict[str, Any]:
        """Return what the file holds of the first `played` samples."""
        columns = {
            name: np.concatenate([getattr(chunk, name) for chunk in self._chunks] or [np.empty((0, 0))])[
                :played
            ]
            for name in ("forces", "states", "parameters", "true", "readings", "covariates")
        }
        index = np.arange(played, dtype=np.int64)
        return {
            "index": index,
            "t_s": index / self._rate,
            **columns,
            "node_names": np.array(self._rig.graph.nodes),
            "state_names": np.array(self._rig.graph.state_names),
            "parameter_names": np.array(self._rig.timeline.names),
            "channel_names": np.array([channel.name for channel in self._rig.channels]),
            "covariate_names": np.array([one.name for one in self._rig.covariates.channels]),
            "ledger": json.dumps(ledger),
        }

    def write(self, path: Path, played: int, ledger: Mapping[str, Any]) -> None:
        """Write the first `played` samples; the file appears whole or not at all."""
        partial = path.with_name(path.name + ".partial")
        with partial.open("wb") as file:
            np.savez(file, **self.arrays(played, ledger))
        partial.replace(path)
