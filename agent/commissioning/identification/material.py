"""Recordings that a rig is identified from: outputs and inputs without gaps, and the sensors' noise."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from agent.commissioning.channel_checks import plain_findings
from agent.commissioning.progress import Progress
from agent.commissioning.readings import Recorded
from agent.commissioning.recording_summary import Material
from agent.commissioning.tuning import SHORTEST_PIECE
from agent.config import RigConfig
from agent.errors import Fault, RecordingError, UsageError
from agent.numerics.inference.tuning import DIGITS
from agent.types import FloatArray


def material_of(recordings: Sequence[Path], probe_s: float | None) -> Material:
    """Return what a rig is identified from. Raises UsageError where that is nothing."""
    if not recordings and probe_s is None:
        advice = "name recordings, or listen to the sources with --probe SECONDS"
        raise UsageError.at("RECORDING", "there is nothing to identify from", advice)
    return Material(recordings, probe_s)


def read_records(config: RigConfig, recordings: Material, progress: Progress) -> list[Recorded]:
    """Read recordings. Raises RecordingError, also for channels that two of them read alike or not at all."""
    records = []
    for name, record in recordings.read(config, progress):
        if found := plain_findings(config, record.measured):
            raise RecordingError([Fault(name, row["words"], "mend the channel first") for row in found])
        records.append(record)
    return records


def noise_of_sensors(config: RigConfig, records: Sequence[Recorded]) -> FloatArray:
    """Noise of each output (p,), SI: as high frequencies show it, else as stated, else a sensor's digits."""
    stated = np.array([(c.noise_sd or 0.0) * c.si_factor for c in config.outputs])
    seen = np.median([record.noise for record in records], axis=0)
    spread = np.max([record.y.std(axis=0) for record in records], axis=0)
    return np.asarray(np.maximum(np.where(seen > 0, seen, stated), np.maximum(DIGITS * spread, 1e-300)))


def pieces_of(records: Sequence[Recorded]) -> list[tuple[FloatArray, FloatArray]]:
    """Return outputs and inputs of what has no gap. Raises RecordingError where all is too short."""
    pieces = [(r.y[a:b], r.u[a:b]) for r in records for a, b in r.pieces if b - a >= SHORTEST_PIECE]
    if not pieces:
        raise no_piece()
    return pieces


def no_piece() -> RecordingError:
    """Return the refusal of recordings without a piece that is long enough."""
    return RecordingError.at("", f"no {SHORTEST_PIECE} samples without a gap", "give a longer recording")


def recorded_span_s(records: Sequence[Recorded]) -> float:
    """Return the time that recordings cover together, s."""
    return float(sum(record.facts["span_s"] for record in records))
