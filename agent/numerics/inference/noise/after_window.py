"""Noise after one window: what was known moves by the window's restricted likelihood."""

from dataclasses import replace

import numpy as np

from agent.numerics.inference import tuning
from agent.numerics.inference.noise.intensities import Scan, first_nodes, scanned, strongest
from agent.numerics.inference.noise.restricted_likelihood import NoiseFit, Ridge
from agent.numerics.inference.noise.state import Noise
from agent.numerics.inference.spectral.columns import Regression
from agent.numerics.inference.spectral.covariance import Cells
from agent.numerics.inference.spectral.sources import Source
from agent.numerics.inference.tuning import FIRST_STEPS
from agent.types import FloatArray, IntArray


def learn(  # noqa: PLR0913, PLR0917
    noise: Noise,
    cells: Cells,
    regression: Regression,
    sources: tuple[Source, ...],
    wide: Ridge,
    pred: Ridge | None,
    least: FloatArray,
    shaken: bool = False,
    anew: bool = False,
) -> tuple[Noise, NoiseFit]:
    """Return the noise after one window, and the fit with its Gram at the new noise.

    wide: prior of the columns with the constants wide; pred: with the constants as known today, for the
    spread. least: (p,) least that log σ may turn out to be: the grids of intensities begin where sources show
    beside it. shaken: the window before was not explained: σ may have changed more than it usually does.
    anew: sources are looked for as in a first window.
    """
    start = noise
    if not noise.is_started:
        empty = np.zeros((len(sources), tuning.NODES))
        start = replace(noise, nodes=first_nodes(cells, least), log_weight=empty)
    if anew:
        start = replace(start, log_weight=np.zeros_like(start.log_weight))
    fit = NoiseFit(start, cells, regression, sources, wide)
    walk = start.walk * (start.windows > 0) + 0.3**2 * shaken
    mean = start.log_sigma
    var = start.log_sigma_var + walk
    carried = np.maximum(tuning.FORGET * start.log_weight, tuning.LOWEST_LOG_WEIGHT)
    every = start.windows < 3
    order = _order(start)
    steps = 1 if start.windows else FIRST_STEPS
    if len(sources) and (anew or not start.windows):
        fit = _start(start, fit, mean, var)
    if every:
        # what is scanned first takes what two can explain: slow forces leave wider intervals than white ones
        order = np.argsort([source.pole == 0 for source in sources], kind="stable")
        fit.score_sigma(mean, var, start, steps)
        scanned(fit, order, carried, start.nodes, every, None)
    fit.score_sigma(mean, var, start, steps)
    scan = scanned(fit, order, carried, start.nodes, every, pred)
    return _after(start, fit, scan), fit


def _start(noise: Noise, fit: NoiseFit, mean: FloatArray, var: FloatArray) -> NoiseFit:
    """The best of joint fits: from weak forces and sensors, and either alone or, later on, strong forces.

    Coordinate steps are greedy, and a joint fit goes to the nearest optimum: from weak forces on it takes
    strong ones for the slow noise of a sensor.
    """
    best = -np.inf
    found = (fit.log_sigma, fit.intensity)
    forces = np.array([source.kind == "force" for source in fit.sources])
    as_sensors = np.clip(first_nodes(fit.cells, mean)[:, 5], noise.nodes[:, 0], noise.nodes[:, -1])
    weak = [(True, True)] if noise.windows else [(True, True), (True, False), (False, True)]
    chosen = [np.where(forces, of_forces, of_sensors) for of_forces, of_sensors in weak]
    starts = [np.where(these, as_sensors, noise.nodes[:, 0]) for these in chosen]
    if noise.windows:
        fit.log_sigma = mean.copy()
        fit.intensity = noise.nodes[:, 0].copy()
        starts.append(strongest(fit, np.flatnonzero(forces), noise.nodes))
    for start in starts:
        fit.log_sigma = mean.copy()
        fit.intensity = start
        fit.joint(mean, var, noise.nodes)
        value = fit.restricted_log_likelihood()
        if value > best:
            best = value
            found = (fit.log_sigma, fit.intensity)
    fit.log_sigma, fit.intensity = found
    return fit


def _order(noise: Noise) -> IntArray:
    """Sources that are active, strongest first, and some of the others in rotation."""
    share = noise.intensity / noise.nodes[:, 0]
    active = np.flatnonzero(share > tuning.ACTIVE_NODES)
    active = active[np.argsort(-share[active])]
    many = 2 * tuning.ROTATION
    rest = np.concatenate([active[many:], np.flatnonzero(~(share > tuning.ACTIVE_NODES))]).astype(np.int64)
    turn = (noise.turn + np.arange(min(tuning.ROTATION, len(rest)))) % max(len(rest), 1)
    return np.sort(np.concatenate([active[:many], rest[turn]])).astype(np.int64)


def _after(noise: Noise, fit: NoiseFit, scan: Scan) -> Noise:
    keep = tuning.FORGET
    # of a sensor's colours only those that are there count
    spread = noise.spread * np.array([source.kind == "force" for source in fit.sources], dtype=float)[:, None]
    log_weight = noise.log_weight.copy()
    for a, value in scan.spread.items():
        spread[a] = value
    for a, logs in scan.log_weight.items():
        log_weight[a] = logs
    seen = fit.seen_dof > 0
    prior = tuning.LEVEL_DOF
    power = np.where(seen, prior + keep * (noise.power - prior) + fit.seen_power, noise.power)
    dof = np.where(seen, prior + keep * (noise.dof - prior) + fit.seen_dof, noise.dof)
    walk, counted = _walk_after(noise, fit)
    information = None
    if len(fit.there):
        information = np.zeros((len(fit.intensity),) * 2)
        information[np.ix_(fit.there, fit.there)] = fit.information
    return Noise(
        fit.log_sigma, fit.log_sigma_var, power, dof, noise.nodes, log_weight, fit.intensity, spread,
        noise.places, noise.windows + 1, noise.turn + tuning.ROTATION, walk, counted, information,
        noise.rounding,
    )  # fmt: skip


def _walk_after(noise: Noise, fit: NoiseFit) -> tuple[float, float]:
    """Return the walk of log σ with one more step of it, and how many it rests on."""
    if not noise.windows:
        return noise.walk, noise.counted
    step = float(np.max((fit.log_sigma - noise.log_sigma) ** 2 - fit.log_sigma_var))
    kept = tuning.FORGET * noise.counted
    return (kept * noise.walk + max(step, 0.0)) / (kept + 1), kept + 1
