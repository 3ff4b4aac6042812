"""Doubts about an identified rig: why its model is refused, and why a parameter is not known."""

import numpy as np

from agent.commissioning.identification.found import Found, Rival
from agent.commissioning.identification.graph import mechanics
from agent.commissioning.numerics.motion.start import hidden
from agent.commissioning.tuning import INSEPARABLE, PULLED, UNEXPLAINED, VAGUE
from agent.config import MechanicsModel, RigConfig
from agent.errors import Fault
from agent.text import percent, with_sd
from agent.types import BoolArray

LOOK_FOR = "look for an element, a force or a mass that the graph lacks, or for a channel that is wrong"
LOOK_AGAIN = (
    "begin at nominals nearer to the machine's, or look for a state, an input or an offset "
    "that the model lacks, for a channel that is wrong, or for a change within the recordings"
)


def refusals(rig: RigConfig, found: Found) -> list[Fault]:
    """Return why the model is not the machine's; empty where it is."""
    is_graph = isinstance(rig.model, MechanicsModel)
    what, advice = ("the graph", found.units or LOOK_FOR) if is_graph else ("the model", LOOK_AGAIN)
    worst = [
        Fault("model", f"{what} leaves {percent(share)} of the motion of {channel.name} unexplained", advice)
        for channel, share in zip(rig.outputs, found.seen.beyond.tolist(), strict=True)
        if not share <= UNEXPLAINED
    ]
    if worst:
        return worst
    if pulled := _pulled(found):
        return [Fault("model", f"{what} fits only with {pulled} than configured", advice)]
    if not found.pooled.converged:
        return [_disagreement(found, advice)]
    return []


def _disagreement(found: Found, advice: str) -> Fault:
    """Say on which parameters windows do not agree, and what would show them."""
    names = [p.name for p, moves in zip(found.rig.parameters, found.pooled.restless, strict=True) if moves]
    places = list(dict.fromkeys(found.helpful.values()))
    way = f"measure the displacement of {' or '.join(places)}, record longer, or " if places else ""
    message = f"the windows of the recordings agree on no values of {', '.join(names)}"
    return Fault("model", message, way + advice)


def _pulled(found: Found) -> str:
    """Return the constant that the data pull beyond its data sheet, in words; nothing where none is."""
    pairs = [
        (c, eta)
        for c, eta in zip(found.constants, found.pooled.eta.tolist(), strict=True)
        if c.kind != "delay"
    ]
    constant, eta = max(pairs, key=lambda pair: abs(pair[1]) / pair[0].sheet, default=(None, 0.0))
    if constant is None or abs(eta) <= PULLED * constant.sheet:
        return ""
    what = constant.name if constant.kind == "mass" else f"the gain of {constant.name}"
    return f"{what} {percent(np.expm1(eta))} {'more' if eta > 0 else 'less'}"


def why_unknown(found: Found, i: int) -> str | None:
    """Return why a parameter is not known, and what would show it; None where it is."""
    if rival := found.rival_in(i):
        return _either(found, rival, i)
    parameter, said = found.rig.parameters[i], found.pooled
    vague = (said.sd > VAGUE * np.abs(said.theta)) | _lines(found)
    if parameter.kind in ("bias", "gain") or not vague[i]:
        return None
    way = f"measure the displacement of {found.helpful[i]}, " if i in found.helpful else ""
    others = [
        p.name for j, p in enumerate(found.rig.parameters)
        if j != i and vague[j] and abs(said.correlation[i, j]) > INSEPARABLE
    ]  # fmt: skip
    if others:
        named = ", ".join(others)
        advice = f"{way}record a motion that moves them differently, or state one of them"
        return f"inseparable from {named}: {advice}"
    return (
        f"unexcited: its part of the motion is too small; {way}record longer, or with more motion across it"
    )


def _either(found: Found, rival: Rival, i: int) -> str:
    """Say both values of a parameter that the recordings leave two of, and what would tell them apart."""
    values = f"{with_sd(found.pooled.theta[i], found.pooled.sd[i])} or {with_sd(rival.theta[i], rival.sd[i])}"
    others = ", ".join(p.name for j, p in enumerate(found.rig.parameters) if j != i and rival.differs[j])
    together = f" (with {others})" if others else ""
    way = f"measure the displacement of {rival.place}" if rival.place else "measure another displacement"
    return f"two solutions explain the recordings alike: {values}{together}; {way}, or state one of them"


def _lines(found: Found) -> BoolArray:
    """Return which parameters (q,) are springs at an unmeasured mass beside a damper that is not known.

    Noise has lines as sharp as that resonance may be: one of them is no spring, however well it fits.
    """
    model = found.config.model
    if not isinstance(model, MechanicsModel):
        return np.zeros(len(found.rig.parameters), dtype=bool)
    unseen = set(hidden(mechanics(found.config))[1])
    values = dict(zip((p.name for p in found.rig.parameters), found.pooled.theta.tolist(), strict=True))
    sds = dict(zip(values, found.pooled.sd.tolist(), strict=True))
    open_ends = [
        set(e.between) for e in model.damper if e.name in values and sds[e.name] > VAGUE * abs(values[e.name])
    ]
    springs = [e for e in model.spring if unseen & set(e.between)]
    names = {e.name for e in springs if set(e.between) in open_ends}
    return np.array([name in names for name in values], dtype=bool)
