"""`deltak identify`: elements of the configured graph from recordings; no nominal is needed, none is trusted.

recordings -> weak form (a start from nothing) -> all windows joined by the estimator's likelihood -> free run
-> values or a refusal. A linear model or a template begins at its nominals, by ever longer windows.
Equations and limits are in docs/identify.md.
"""

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from agent.blocks.rig_model import rig_model
from agent.commissioning.explained import Explained
from agent.commissioning.identification.document import document_of
from agent.commissioning.identification.doubts import LOOK_FOR, refusals
from agent.commissioning.identification.found import Found
from agent.commissioning.identification.graph import require_motion_sensors, with_blanks
from agent.commissioning.identification.join import joined
from agent.commissioning.identification.material import material_of, read_records, recorded_span_s
from agent.commissioning.identification.start import started_linear, starts
from agent.commissioning.identification.units import fitting_units
from agent.commissioning.nominals import write_nominals
from agent.commissioning.progress import Progress, on_terminal
from agent.commissioning.recording_summary import Material
from agent.config import MechanicsModel, RigConfig, load
from agent.errors import ModelError
from agent.runtime.assembly.model_check import model_faults


def identify(
    *, config: Path, recordings: Sequence[Path], probe_s: float | None = None, write: bool = False,
    progress: Progress | None = None,
) -> tuple[dict[str, Any], Explained]:  # fmt: skip
    """Identify a rig; return the document of CONTRACT section 8, and predicted against measured motion.

    "ok" is false, with "errors", where the graph is not the machine's; nothing is written then. Raises
    ConfigError, RecordingError, ModelError, UsageError.
    """
    began = time.monotonic()
    said = progress or on_terminal()
    rig = load(config, identified=True)
    try:
        found, span_s = _identified(rig, material_of(recordings, probe_s), said)
    except np.linalg.LinAlgError as error:
        what = "no values of the graph's elements give this motion"
        raise ModelError.at("model", what, LOOK_FOR) from error
    finally:
        said("")
    document = document_of(rig, found) | {"span_s": span_s, "seconds": time.monotonic() - began}
    if write and document["ok"]:
        write_nominals(rig, {change["parameter"]: change["to"] for change in document["changes"]})
        document["written"] = str(config)
    return document, found.seen


def _identified(rig: RigConfig, recordings: Material, progress: Progress) -> tuple[Found, float]:
    if not isinstance(rig.model, MechanicsModel):
        records = read_records(rig, recordings, progress)
        return joined(started_linear(rig, records, progress), records, progress), recorded_span_s(records)
    blank = with_blanks(rig)
    require_motion_sensors(blank)
    records = read_records(blank, recordings, progress)
    progress("solving the weak form")
    begun = starts(blank, records)
    if rig.model.friction:
        # the signs of velocities come from a model, which is now a better one
        records = read_records(begun[0], recordings, progress)
        begun = starts(begun[0], records)
    if faults := model_faults(begun[0], rig_model(begun[0])):
        raise ModelError(faults)
    found = joined(begun[0], records, progress, begun[1:])
    if refusals(rig, found):
        found = replace(found, units=fitting_units(begun[0], records, progress))
    return found, recorded_span_s(records)
