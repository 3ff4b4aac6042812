"""`deltak compare`: window-ml beside its rivals on a user's own recording.

Everyone begins at the configuration's nominals, is tuned on the first third and scored on what comes after:
each window is predicted by a free run of the model at what was known before it, from the state that its
readings fit best.
"""

from pathlib import Path
from typing import Any

import numpy as np

from agent.commissioning.progress import Progress, on_terminal
from agent.commissioning.recording_summary import read_recording
from agent.config import load
from agent.evaluation.compare.methods import NotApplicableError, chosen, tuned
from agent.evaluation.compare.trial import Estimates, Trial, trial_of


def compare(
    *, config: Path, recording: Path, methods: str | None, progress: Progress | None = None
) -> tuple[dict[str, Any], dict[str, Estimates]]:
    """Return the document of CONTRACT section 8, and each method's rows.

    Raises ConfigError, ModelError, RecordingError, UsageError.
    """
    said = progress or on_terminal()
    names = chosen(methods)
    rig = load(config)
    try:
        recorded = read_recording(rig, recording)
        trial = trial_of(rig, recorded)
        rows, ran, skipped = {}, {}, {}
        for name in names:
            said(f"{name}: tuning and running")
            try:
                rows[name], ran[name] = _ran(trial, name)
            except NotApplicableError as reason:
                skipped[name] = str(reason)
    finally:
        said("")
    document = {
        "rig": rig.rig.name, "recording": recorded.name, "samples": len(trial.y),
        "window_s": trial.window * trial.period_s, "windows": len(trial.scored()), "methods": rows,
        "skipped": skipped,
        "noise": {c.name: sd / c.si_factor for c, sd in zip(rig.outputs, trial.noise.tolist(), strict=True)},
    }  # fmt: skip
    return document, ran


def _ran(trial: Trial, name: str) -> tuple[dict[str, Any], Estimates]:
    method = tuned(name, trial)
    found = method.run()
    left = trial.left(found, trial.scored())
    motion = trial.motion(trial.scored())
    row = {
        "estimates": {p.name: _newest(found, i, p.unit) for i, p in enumerate(trial.rig.parameters)},
        "prediction_rms": float(np.sqrt(np.mean(left))),
        "prediction_percent": 100.0 * float(np.sqrt(np.mean(left / np.maximum(motion, 1e-300)))),
        "prediction": {
            c.name: float(np.sqrt(square)) * sd / c.si_factor
            for c, square, sd in zip(trial.config.outputs, left.tolist(), trial.noise.tolist(), strict=True)
        },
        "cost_us_per_sample": found.microseconds, "tuned": method.words,
    }  # fmt: skip
    return row, found


def _newest(found: Estimates, column: int, unit: str) -> dict[str, Any]:
    """Return the newest valid row of a parameter; None where there is none."""
    rows = np.flatnonzero(found.valid[:, column])
    at = int(rows[-1]) if len(rows) else None
    fields = ("theta", "sd", "lower", "upper")
    value, sd, lower, upper = (None if at is None else float(getattr(found, f)[at, column]) for f in fields)
    return {
        "value": value, "sd": sd, "lower": lower, "upper": upper, "unit": unit, "n_valid": len(rows),
        "n_rows": len(found.index),
    }  # fmt: skip
