"""What a region's picture shows: poles over the box, spectral radii over a two-parameter plane, estimates."""

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.linalg import expm

from agent.blocks.rig_model import RigModel
from agent.commissioning.tuning import BEYOND_BOX, DRAWN_POINTS, GRID
from agent.config import RigConfig
from agent.errors import UsageError
from agent.numerics.paper.region import Measure, radius_of_model, radius_of_observer
from agent.storage.read import queries
from agent.types import ComplexArray, FloatArray


@dataclass(frozen=True, slots=True)
class Today:
    """The newest valid estimates of a database: (q,) values and sd (nominal and NaN if none); their time."""

    theta: FloatArray
    sd: FloatArray
    time: str


@dataclass(frozen=True, slots=True)
class Plane:
    """Spectral radii over two parameters, the others where they are.

    Attributes:
        numbers: of the two parameters.
        x, y: (g,) their values.
        radius: (g, g) the larger one of model and observer, rows along y: (3) holds below 1.
    """

    numbers: tuple[int, int]
    x: FloatArray
    y: FloatArray
    radius: FloatArray


def newest(config: RigConfig, rig: RigModel, db: Path) -> Today:
    """Return today's estimates of a rig. Raises StoreError; UsageError if there is none of its parameters."""
    rows = {row["parameter"]: row for row in queries.latest(db, config.rig.name) if row["status"] == "valid"}
    found = [rows.get(parameter.name) for parameter in rig.parameters]
    if not any(found):
        what = f"{db} has no valid estimate of {config.rig.name}"
        raise UsageError.at(
            "--db", what, "leave it out, or wait for one: deltak estimates says what rows there are"
        )
    theta = np.array(
        [row["value"] if row else p.nominal for row, p in zip(found, rig.parameters, strict=True)]
    )
    sd = np.array([row["sd"] if row else np.nan for row in found])
    return Today(theta, sd, max(str(row["time"]) for row in found if row))


def poles_over(config: RigConfig, rig: RigModel, gain: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return discrete-time poles of model and observer, (k, n) each, at points of the box, nominal first."""
    rng = np.random.default_rng(19)
    half = np.maximum(rig.limits, 0.0)
    # half of the points on edges of the box, where poles reach furthest
    shares = np.sign(rng.uniform(-1, 1, (DRAWN_POINTS, len(half)))) * np.where(
        np.arange(DRAWN_POINTS)[:, None] % 2, 1.0, np.nan
    )
    shares = np.where(np.isnan(shares), rng.uniform(-1, 1, shares.shape), shares)
    points = np.vstack([rig.model.nominal, rig.model.nominal + shares * half])
    found = [_poles(config, rig, gain, theta) for theta in points]
    return np.array([one[0] for one in found]), np.array([one[1] for one in found])


def _poles(
    config: RigConfig, rig: RigModel, gain: FloatArray, theta: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    at = rig.model.continuous(theta)
    A = at.A if at.is_sampled else expm(at.A / config.rig.sample_rate_hz)  # noqa: N806 - a letter of the books
    return np.linalg.eigvals(A).astype(complex), np.linalg.eigvals(A - gain @ at.C).astype(complex)


def plane(config: RigConfig, rig: RigModel, gain: FloatArray, around: FloatArray) -> Plane | None:
    """Return the plane of the two parameters that change the radius most; None with fewer than two limits.

    around: (q,) where the other parameters are.
    """
    half = np.maximum(rig.limits, 0.0)
    movable = np.flatnonzero(half > 0).tolist()
    if len(movable) < 2:
        return None
    period_s = 1.0 / config.rig.sample_rate_hz
    measures = [radius_of_model(rig.model, period_s), radius_of_observer(rig.model, period_s, gain)]
    i, j = max(combinations(movable, 2), key=lambda pair: _effect(measures[1], rig.model.nominal, half, pair))
    x, y = (np.linspace(-BEYOND_BOX, BEYOND_BOX, GRID) * half[k] + rig.model.nominal[k] for k in (i, j))
    radius = np.array([[_radius(measures, around, (i, j), (a, b)) for a in x.tolist()] for b in y.tolist()])
    return Plane((i, j), x, y, radius)


def _effect(measure: Measure, nominal: FloatArray, half: FloatArray, pair: tuple[int, ...]) -> float:
    """Return how much a measure changes over the sides of the box along two parameters."""
    sides = [np.eye(len(half))[k] * half[k] for k in pair]
    return float(sum(abs(measure(nominal + side) - measure(nominal - side)) for side in sides))


def _radius(
    measures: list[Measure], around: FloatArray, pair: tuple[int, int], values: tuple[float, float]
) -> float:
    theta = around.copy()
    theta[list(pair)] = values
    with np.errstate(all="ignore"):
        try:
            return max(measure(theta) for measure in measures)
        except (ValueError, np.linalg.LinAlgError):
            return float("nan")
