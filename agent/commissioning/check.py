"""`deltak check`: what a configuration can and cannot do, before anything is connected."""

from collections.abc import Callable, Iterator
from math import pi
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from agent.blocks.rig_model import RigModel, hop_plan, longer_windows, observer_gain, rig_model, settled_gain
from agent.commissioning.advice import warnings
from agent.commissioning.baseline.limits import limit_warnings
from agent.commissioning.evidence import Evidence, Gathered
from agent.commissioning.prediction import predictions, rows, sampled
from agent.commissioning.progress import Progress, on_terminal
from agent.commissioning.recorded_windows import (
    left_open,
    paper_conditions,
    recentring_faults,
    recentring_ratio,
)
from agent.commissioning.tuning import OBSERVER_ROUNDS, WORST_ROUNDS
from agent.config import RigConfig, load
from agent.errors import ConfigError, Fault
from agent.numerics.model.statespace import Discrete, modes
from agent.numerics.paper.margins import condition_3, condition_8
from agent.numerics.paper.margins_box import DesignToolsMissingError, polytopic_margin
from agent.numerics.paper.region import (
    hidden_mode,
    named,
    perturbation,
    radius_of_model,
    radius_of_observer,
    worst_in_box,
)
from agent.numerics.paper.tuning import MOST_PARAMETERS
from agent.runtime.assembly.model_check import hidden_states, model_faults
from agent.runtime.assembly.number_checks import attempted
from agent.runtime.assembly.source_faults import source_error
from agent.runtime.sources import wire_steps
from agent.storage.write.retention import Retention, bytes_per_rig_year
from agent.text import number
from agent.types import FloatArray
from drivers.port import DriverConfigError

T = TypeVar("T")
_NOTHING: dict[str, Any] = {
    "observable": None, "poles": [], "observer": None, "condition_3": None, "condition_8": None,
    "region": None,
    "box_margin": None, "paper_conditions": None, "recentring": None,
    "predicted_sd": [], "recording": None, "probe": None, "bytes_per_rig_year": None,
}  # fmt: skip


def check(
    *, config: Path, recording: Path | None, probe: bool, progress: Progress | None = None
) -> dict[str, Any]:
    """Check a configuration; return the CONTRACT section 8 document, "ok" false and all faults in "errors".

    Args:
        config: the file.
        recording: judge with its excitation and noise instead of a white force of 1 N rms.
        probe: listen to the sources for some seconds and judge with what they deliver.
        progress: told how far long work is; a terminal's own line by default.

    Raises UsageError for a probe without sources, RecordingError for a recording that cannot be used,
    BusError for a source that cannot be opened.
    """
    try:
        rig_config = load(config)
        resolution = resolution_of(rig_config)
    except ConfigError as error:
        file_alone = recording is None and not probe
        return _unread(error, accepted=file_alone and _lacks_nominals_only(config))
    return _document(rig_config, resolution, Evidence(recording, probe, progress or on_terminal()))


def _unread(error: ConfigError, *, accepted: bool) -> dict[str, Any]:
    """Return the document of a file with faults, which are warnings where it is accepted as it is."""
    faults = [_fault(fault) for fault in error.faults]
    return {
        "ok": accepted,
        "errors": [] if accepted else faults,
        "warnings": faults if accepted else [],
    } | _NOTHING


def _lacks_nominals_only(config: Path) -> bool:
    """Tell whether all that a file lacks is what `deltak identify` finds."""
    try:
        resolution_of(load(config, identified=True))
    except ConfigError:
        return False
    return True


def _fault(fault: Fault) -> dict[str, str]:
    return {"path": fault.path, "message": fault.message, "advice": fault.advice}


def resolution_of(config: RigConfig) -> FloatArray:
    """The wire's smallest step of each output (p,), SI."""
    try:
        steps = wire_steps(config)
    except DriverConfigError as error:
        raise source_error([config], error) from error
    return np.array([steps.get(c.name, 0.0) * abs(c.scale) * c.si_factor for c in config.outputs])


def _document(config: RigConfig, resolution: FloatArray, evidence: Evidence) -> dict[str, Any]:
    with np.errstate(all="ignore"):  # what is no number is a fault
        rig = rig_model(config)
    faults = model_faults(config, rig)
    document = {"ok": not faults, "errors": [_fault(fault) for fault in faults], "warnings": []} | _NOTHING
    document |= attempted(lambda: _structure(config, rig), "its structure", "model", []) or {}
    if faults:
        return document
    gathered = evidence.gather(config)
    document |= {"recording": gathered.recording, "probe": gathered.probe}
    evidence.progress("weighing what windows can tell")
    found = _dynamic(config, rig, resolution, gathered)
    evidence.progress("")
    return document | found


def _structure(config: RigConfig, rig: RigModel) -> dict[str, Any]:
    observable = not hidden_states(rig.model)
    return {"observable": observable, "poles": poles(config, rig), "bytes_per_rig_year": _bytes(config, rig)}


def poles(config: RigConfig, rig: RigModel) -> list[dict[str, float | None]]:
    """Return the continuous-time poles of the nominal model, slowest first."""
    found = modes(rig.model.continuous(rig.model.nominal), 1.0 / config.rig.sample_rate_hz)
    return [
        {
            "re": float(pole.real), "im": float(pole.imag), "freq_hz": abs(pole) / (2 * pi),
            "damping_ratio": float(-pole.real / abs(pole)) if abs(pole) > 0 else None,
        }
        for pole in sorted(found.tolist(), key=lambda pole: (abs(pole), pole.imag))
    ]  # fmt: skip


def _bytes(config: RigConfig, rig: RigModel) -> int:
    keep, store = config.store.keep, config.store
    retention = Retention(keep.full, keep.minute, keep.hour, store.max_mb * 1e6)
    sources = max(1, len(config.source))
    windows = 1 + len(longer_windows(config, hop_plan(config)))
    rows = store.every_s, config.estimator.hop_s
    return bytes_per_rig_year(len(rig.parameters), *rows, retention, sources, windows, len(config.covariate))


def _bound(config: RigConfig, rig: RigModel) -> Iterator[Fault]:
    """Yield what is to be warned of where the file cannot be as small as it is to be."""
    most_mb = config.store.max_mb
    least = _bytes(config, rig)
    if least > most_mb * 1e6:
        what = f"{number(most_mb)} MB are less than the newest hour of rows takes"
        what = f"{what}, {least / 1e6:.0f} MB, and it always stays"
        yield Fault("store.max_mb", what, "give it more, or keep fewer rows: store.every_s")


def _dynamic(config: RigConfig, rig: RigModel, resolution: FloatArray, gathered: Gathered) -> dict[str, Any]:
    """What only a model without faults has: observer, conditions, the sd to expect, warnings."""
    discrete = sampled(config, rig)
    start = observer_gain(config, rig, discrete, resolution)
    gain = settled_gain(config, discrete, start)
    recorded = gathered.recorded
    failed = list[Fault]()

    def tried(what: str, work: Callable[[], T]) -> T | None:
        return attempted(work, what, "model", failed)

    predicted = tried("the sd to expect", lambda: predictions(config, rig, resolution, recorded)) or []
    passes = tried("re-centring", lambda: recentring_ratio(config, rig, discrete, start, recorded))
    found = {
        "observer": _observer(discrete, gain) | {"start": _observer(discrete, start)},
        "condition_3": tried("condition (3)", lambda: _condition_3(discrete, gain)),
        "condition_8": tried("condition (8)", lambda: _condition_8(config, rig, discrete, gain)),
        "region": tried("the conditions over the region", lambda: _region(config, rig, gain)),
        "box_margin": tried("the range proven stable", lambda: _box(rig)),
        "paper_conditions": tried(
            "(11) to (15)", lambda: paper_conditions(config, discrete, start, recorded)
        ),
        "recentring": passes,
        "predicted_sd": rows(predicted, config, rig),
    }
    learnt = limit_warnings(config)
    unseen = (
        tried("what the recording leaves open", lambda: left_open(config, rig, resolution, recorded)) or []
    )
    warned = [
        *warnings(config, rig, predicted, recorded),
        *learnt,
        *unseen,
        *recentring_faults(passes),
        *gathered.warnings,
        *_bound(config, rig),
        *failed,
    ]
    return found | {"warnings": [_fault(fault) for fault in warned]}


def _observer(discrete: Discrete, gain: FloatArray) -> dict[str, Any]:
    found = np.linalg.eigvals(discrete.model.A - gain @ discrete.model.C).tolist()
    return {"gain": gain.tolist(), "poles_z": [{"re": float(z.real), "im": float(z.imag)} for z in found]}


def _condition_3(discrete: Discrete, gain: FloatArray) -> dict[str, Any]:
    found = condition_3(discrete.model.A, gain, discrete.model.C)
    return {
        "holds": found.holds,
        "radius_model": found.radius_model,
        "radius_observer": found.radius_observer,
    }


def _condition_8(config: RigConfig, rig: RigModel, discrete: Discrete, gain: FloatArray) -> dict[str, Any]:
    """Evaluate (8) for parameters anywhere within their alarm limits."""
    measure = perturbation(rig.model, 1.0 / config.rig.sample_rate_hz, gain)
    size = worst_in_box(measure, rig.model.nominal, rig.limits, inside=False).value
    none = np.zeros_like(discrete.model.A)
    margin = condition_8(discrete.model.A, gain, discrete.model.C, none, np.zeros_like(discrete.model.C))
    return {
        "delta": margin.delta, "h_infinity": margin.h_infinity, "perturbation_norm": size,
        "holds": size < margin.delta,
    }  # fmt: skip


def _region(config: RigConfig, rig: RigModel, gain: FloatArray) -> dict[str, Any]:
    """Evaluate (3) and observability wherever parameters may be before an alarm: the worst point of each."""
    period_s = 1.0 / config.rig.sample_rate_hz
    model, nominal = rig.model, rig.model.nominal
    measures = {"radius_model": radius_of_model(model, period_s), "observability": hidden_mode(model)}
    if gain.any():
        measures["radius_observer"] = radius_of_observer(model, period_s, gain)
    found = {}
    for name, measure in measures.items():
        worst = worst_in_box(
            measure, nominal, rig.limits, OBSERVER_ROUNDS if name == "radius_observer" else WORST_ROUNDS
        )
        found[name] = {
            "nominal": abs(measure(nominal)), "value": abs(worst.value),
            "at": named(model.parameters, worst.theta),
            "at_vertex": worst.at_vertex,
        }  # fmt: skip
    return {"radius_observer": found["radius_model"]} | found  # without a gain the observer is the model


def _box(rig: RigModel) -> dict[str, Any] | None:
    """The polytopic margin in shares of alarm limits; None without design tools or where it cannot be had.

    Raises ValueError for more parameters than it can be had for: what is left out is said.
    """
    limits = np.maximum(rig.limits, 0.0)
    if np.count_nonzero(limits) > MOST_PARAMETERS:
        words = f"{np.count_nonzero(limits)} parameters have a limit, at most {MOST_PARAMETERS} can be tried"
        raise ValueError(f"{words}; the worst point above was searched for all the same")
    try:
        found = polytopic_margin(rig.model, limits)
    except (DesignToolsMissingError, ValueError):
        return None
    return {"share": found.share, "reach": dict(found.reach)}
