"""What was learnt of a rig as JSON text, and back: for the next start.

Arrays are their doubles as they stand, in base64: in decimal digits they are four times as long, and to write
them takes half as long as to learn from a window.
"""

import json
from base64 import b64decode, b64encode
from dataclasses import replace
from typing import Any

import numpy as np

from agent.numerics.estimator.tuning import LINE_LEVEL
from agent.numerics.inference.constants import Constants
from agent.numerics.inference.noise.rounding import Rounding
from agent.numerics.inference.noise.state import Noise, Places
from agent.numerics.inference.posterior import Footing, Knowledge
from agent.numerics.inference.scatter import Scatter
from agent.numerics.preprocessing.wire import Wire
from agent.types import FloatArray, IntArray

VERSION = 2  # fixed by the memory's form
_BEFORE = 1  # fixed by the form before: arrays were lists of decimal numbers


def to_text(known: Knowledge) -> str:
    """Return knowledge as JSON text."""
    noise, constants, scatter = known.noise, known.constants, known.scatter
    content = {
        "version": VERSION, "theta": _packed(known.theta), "eta": _packed(known.eta), "kept": known.kept,
        "footing": None if known.footing is None else _footing(known.footing),
        "noise": {
            "log_sigma": _packed(noise.log_sigma), "log_sigma_var": _packed(noise.log_sigma_var),
            "power": _sparse(noise.power), "dof": _sparse(noise.dof), "nodes": _packed(noise.nodes),
            "log_weight": _packed(noise.log_weight), "intensity": _packed(noise.intensity),
            "spread": _packed(noise.spread), "windows": noise.windows, "turn": noise.turn,
            "walk": noise.walk, "counted": noise.counted,
        } | ({} if noise.information is None else {"information": _packed(noise.information)})
          | ({} if noise.rounding is None else {"rounding": _rounding(noise.rounding)})
          | {"places": _places(noise.places, noise.levels)},
        "constants": {
            "names": [h.name for h in constants.hypotheses], "weight": _packed(constants.weight),
            "mean": _packed(constants.mean), "covariance": _packed(constants.covariance),
        },
        "scatter": {
            "within": _packed(scatter.within), "between": _packed(scatter.between), "dof": scatter.dof,
            "compared": scatter.compared,
        },
    } | ({} if known.stretch is None else {"stretch": _packed(known.stretch)})  # fmt: skip
    return json.dumps(content, sort_keys=True, allow_nan=False)


def from_text(content: str, fresh: Knowledge, wire: Wire, cubics: int = 0) -> Knowledge | None:
    """Return knowledge from its text; None where it is of another version or of other sizes than `fresh`.

    wire: what outputs come in;  cubics: how many of the last constants earlier programs did not have.
    """
    found = json.loads(content)
    if found.get("version") not in {_BEFORE, VERSION}:
        return None
    eta = _array(found["eta"])
    later = len(fresh.eta) - len(eta)
    if later not in {0, cubics}:
        return None
    if (constants := _constants_of(found["constants"], fresh.constants, len(eta))) is None:
        return None
    if found.get("footing") is None:  # earlier programs did not keep it
        return None
    n, s = found["noise"], found["scatter"]
    noise = Noise(
        _array(n["log_sigma"]), _array(n["log_sigma_var"]), _dense(n["power"], fresh.noise.power),
        _dense(n["dof"], fresh.noise.dof),
        _array(n["nodes"]), _array(n["log_weight"]), _array(n["intensity"]), _array(n["spread"]),
        _places_of(n.get("places"), fresh.noise.power), n["windows"], n["turn"], n["walk"], n["counted"],
        # earlier programs did not keep it
        None if n.get("information") is None else _array(n["information"]),
        _rounding_of(n.get("rounding"), wire),
    )  # fmt: skip
    sizes = [(one.log_sigma.shape, one.intensity.shape) for one in (noise, fresh.noise)]
    if sizes[0] != sizes[1]:
        return None
    scatter = Scatter(_array(s["within"]), _array(s["between"]), s["dof"], s["compared"])
    known = Knowledge(
        _array(found["theta"]), np.pad(eta, (0, later)), noise, constants, scatter, found["kept"]
    )
    stretch = found.get("stretch")
    footing = _footing_of(found["footing"], len(fresh.eta))
    return replace(known, footing=footing, stretch=None if stretch is None else _array(stretch))


def _constants_of(kept: dict[str, Any], first: Constants, size: int) -> Constants | None:
    """Return what was known of the first `size` constants; what earlier programs did not have begins anew."""
    names = kept["names"]
    count = len(names)
    old = _array(kept["covariance"])
    if [h.name for h in first.hypotheses[:count]] != names or old.size != count * size**2:
        return None
    weight = np.concatenate([(1 - first.weight[count:].sum()) * _array(kept["weight"]), first.weight[count:]])
    mean, covariance = first.mean.copy(), first.covariance.copy()
    mean[:count, :size] = _array(kept["mean"]).reshape(count, size)
    covariance[:count, :size, :size] = old.reshape(count, size, size)
    return Constants(first.hypotheses, weight, mean, covariance)


def _footing(footing: Footing) -> dict[str, object]:
    return {"information": _packed(footing.information), "sensitivity": _packed(footing.sensitivity)}


def _footing_of(kept: dict[str, Any], constants: int) -> Footing:
    information = _array(kept["information"])
    sensitivity = _array(kept["sensitivity"]).reshape(len(information), -1)
    return Footing(information, np.pad(sensitivity, ((0, 0), (0, constants - sensitivity.shape[1]))))


def _rounding(rounding: Rounding) -> dict[str, object]:
    return {
        "digits": rounding.digits.tolist(), "usual": _packed(rounding.usual),
        "of_power": _packed(rounding.of_power), "of_score": _packed(rounding.of_score),
    }  # fmt: skip


def _rounding_of(kept: dict[str, Any] | None, wire: Wire) -> Rounding | None:
    if kept is None:
        return None
    each = (_array(kept[part]) for part in ("usual", "of_power", "of_score"))
    return Rounding(np.array(kept["digits"], dtype=np.int64), wire, *each)


def _places(places: Places, levels: FloatArray) -> dict[str, object]:
    """Bins in which a line is, of any channel."""
    lines = np.flatnonzero((levels > LINE_LEVEL).any(axis=1))
    nothing = np.zeros(levels.shape[1])
    return {
        "along": _of_bins(places.along, nothing, lines), "squares": _of_bins(places.squares, nothing, lines),
    }  # fmt: skip


def _places_of(kept: dict[str, Any] | None, fresh: FloatArray) -> Places:
    if kept is None:  # earlier programs did not keep them
        return Places.unseen(*fresh.shape)
    return Places(_dense(kept["along"], fresh), _dense(kept["squares"], fresh))


def _packed(values: FloatArray) -> dict[str, object]:
    doubles = np.ascontiguousarray(values, dtype="<f8")
    if not np.isfinite(doubles).all():
        raise ValueError("what was learnt is not finite")
    return {"shape": list(doubles.shape), "base64": b64encode(doubles.tobytes()).decode("ascii")}


def _array(kept: Any) -> FloatArray:
    """Return what `_packed` packed, or of the form before an array of decimal numbers."""
    if isinstance(kept, list):
        return np.array(kept, dtype=float)
    return np.frombuffer(b64decode(kept["base64"]), dtype="<f8").reshape(kept["shape"]).copy()


def _sparse(values: FloatArray) -> dict[str, object]:
    """Bins that differ from what is usual: most do not by much, and a minute's window has 30,000."""
    usual = np.median(values, axis=0)
    odd = np.flatnonzero((np.abs(values / usual - 1) > 0.5).any(axis=1))
    return _of_bins(values, usual, odd)


def _of_bins(values: FloatArray, usual: FloatArray, bins: IntArray) -> dict[str, object]:
    return {"usual": _packed(usual), "bins": bins.tolist(), "values": _packed(values[bins])}


def _dense(kept: dict[str, Any], fresh: FloatArray) -> FloatArray:
    out = np.tile(_array(kept["usual"]), (len(fresh), 1))
    inside = [i for i, place in enumerate(kept["bins"]) if place < len(fresh)]
    if inside:
        out[np.array(kept["bins"])[inside]] = _array(kept["values"])[inside]
    return out
