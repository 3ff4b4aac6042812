"""What was learnt of a rig as JSON text, and back: for the next start."""

import json
from dataclasses import replace

import numpy as np

from agent.numerics.inference.constants import Constants, Hypothesis
from agent.numerics.inference.noise.rounding import Rounding
from agent.numerics.inference.noise.state import Noise
from agent.numerics.inference.posterior import Footing, Knowledge
from agent.numerics.inference.scatter import Scatter

VERSION = 1  # fixed by the memory's form


def to_text(known: Knowledge) -> str:
    """Return knowledge as JSON text, arrays to nine digits."""
    noise, constants, scatter = known.noise, known.constants, known.scatter
    content = {
        "version": VERSION, "theta": _list(known.theta), "eta": _list(known.eta), "kept": known.kept,
        "footing": None if known.footing is None else _footing(known.footing),
        "noise": {
            "log_sigma": _list(noise.log_sigma), "log_sigma_var": _list(noise.log_sigma_var),
            "power": _sparse(noise.power), "dof": _sparse(noise.dof), "nodes": _list(noise.nodes),
            "log_weight": _list(noise.log_weight), "intensity": _list(noise.intensity),
            "spread": _list(noise.spread), "windows": noise.windows, "turn": noise.turn,
            "walk": noise.walk, "counted": noise.counted,
        } | ({} if noise.information is None else {"information": _list(noise.information)})
          | ({} if noise.rounding is None else {"rounding": _rounding(noise.rounding)}),
        "constants": {
            "names": [h.name for h in constants.hypotheses], "weight": _list(constants.weight),
            "mean": _list(constants.mean), "covariance": _list(constants.covariance),
        },
        "scatter": {
            "within": _list(scatter.within), "between": _list(scatter.between), "dof": scatter.dof,
            "compared": scatter.compared,
        },
    }  # fmt: skip
    return json.dumps(content, sort_keys=True, allow_nan=False)


def from_text(content: str, hypotheses: tuple[Hypothesis, ...], fresh: Noise) -> Knowledge | None:
    """Return knowledge from its text; None where it is of another version or of other sizes than `fresh`."""
    found = json.loads(content)
    if found.get("version") != VERSION or found["constants"]["names"] != [h.name for h in hypotheses]:
        return None
    if found.get("footing") is None:  # earlier programs did not keep it
        return None
    n, c, s = found["noise"], found["constants"], found["scatter"]
    array = np.array
    noise = Noise(
        array(n["log_sigma"]), array(n["log_sigma_var"]), _dense(n["power"], fresh.power),
        _dense(n["dof"], fresh.dof),
        array(n["nodes"]), array(n["log_weight"]), array(n["intensity"]), array(n["spread"]), n["windows"],
        n["turn"],
        n["walk"], n["counted"],
        None if n.get("information") is None else array(n["information"]),  # earlier programs did not keep it
        _rounding_of(n.get("rounding")),
    )  # fmt: skip
    if noise.log_sigma.shape != fresh.log_sigma.shape or noise.intensity.shape != fresh.intensity.shape:
        return None
    count = len(found["eta"])
    if count != hypotheses[0].members.size:
        return None
    constants = Constants(
        hypotheses, array(c["weight"]), array(c["mean"]).reshape(len(hypotheses), count),
        array(c["covariance"]).reshape(len(hypotheses), count, count),
    )  # fmt: skip
    scatter = Scatter(array(s["within"]), array(s["between"]), s["dof"], s["compared"])
    known = Knowledge(array(found["theta"]), array(found["eta"]), noise, constants, scatter, found["kept"])
    return replace(known, footing=_footing_of(found["footing"], count))


def _footing(footing: Footing) -> dict[str, object]:
    return {"information": _list(footing.information), "sensitivity": _list(footing.sensitivity)}


def _footing_of(kept: dict[str, list], constants: int) -> Footing:  # type: ignore[type-arg]
    information = np.array(kept["information"])
    return Footing(information, np.array(kept["sensitivity"]).reshape(len(information), constants))


def _rounding(rounding: Rounding) -> dict[str, object]:
    return {
        "digits": rounding.digits.tolist(), "usual": _list(rounding.usual),
        "of_power": _list(rounding.of_power), "of_score": _list(rounding.of_score),
    }  # fmt: skip


def _rounding_of(kept: dict[str, list] | None) -> Rounding | None:  # type: ignore[type-arg]
    if kept is None:
        return None
    each = (np.array(kept[part], dtype=float) for part in ("usual", "of_power", "of_score"))
    return Rounding(np.array(kept["digits"], dtype=np.int64), *each)


def _list(values: np.ndarray) -> object:
    short = [float(f"{x:.9g}") for x in values.ravel().tolist()]
    return np.reshape(short, values.shape).tolist() if short else []


def _sparse(values: np.ndarray) -> dict[str, object]:
    """Bins that differ from what is usual: most do not by much, and a minute's window has 30,000."""
    usual = np.median(values, axis=0)
    odd = np.flatnonzero((np.abs(values / usual - 1) > 0.5).any(axis=1))
    return {"usual": _list(usual), "bins": odd.tolist(), "values": _list(values[odd])}


def _dense(kept: dict[str, list], fresh: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    out = np.tile(np.array(kept["usual"]), (len(fresh), 1)).astype(float)
    inside = [i for i, place in enumerate(kept["bins"]) if place < len(fresh)]
    if inside:
        out[np.array(kept["bins"])[inside]] = np.array(kept["values"])[inside]
    return out
