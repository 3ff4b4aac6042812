"""References of a rig's estimates: nominal values, or baselines where they were learnt of the same graph."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import nan

import numpy as np

from agent.blocks.covariates.compensation import dependences
from agent.blocks.estimation import Labels
from agent.records import Baseline


def counted_from(
    labels: Labels, baselines: Sequence[Baseline], graph: str, covariates: Mapping[str, str] | None = None
) -> tuple[Labels, list[str]]:
    """Return labels whose references are baselines where any fit; and why others do not, in words.

    labels: with nominal references. graph: of the rig; a baseline that knows none fits any. covariates: their
    units.
    """
    units = dict(zip(labels.parameters, labels.units, strict=True))
    own = [
        (one, _unfitting(one, units, graph, covariates or {})) for one in baselines if one.parameter in units
    ]
    refused = [words for _, words in own if words]
    fitting = {one.parameter: one for one, words in own if not words}
    return _labelled(labels, fitting) if fitting else labels, refused


def _labelled(labels: Labels, fitting: Mapping[str, Baseline]) -> Labels:
    found = [fitting.get(name) for name in labels.parameters]
    nominal = labels.reference.tolist()
    return replace(
        labels,
        reference=np.array(
            [n if one is None else one.reference for one, n in zip(found, nominal, strict=True)]
        ),
        baseline_id=tuple(None if one is None else one.baseline_id for one in found),
        reference_sd=tuple(nan if one is None else one.sd for one in found),
    )


def _unfitting(one: Baseline, units: Mapping[str, str], graph: str, covariates: Mapping[str, str]) -> str:
    unit = units[one.parameter]
    if one.unit != unit:
        return f"the baseline of {one.parameter} is in {one.unit}, its estimates are in {unit}"
    if one.graph and one.graph != graph:
        return f"the baseline of {one.parameter} is of another graph ({one.graph})"
    strange = [d for d in dependences(one) if covariates.get(d.name, d.unit) != d.unit]
    if strange:
        name, there, here = strange[0].name, strange[0].unit, covariates[strange[0].name]
        return f"the baseline of {one.parameter} counts {name} in {there}, which is in {here} here"
    return ""
