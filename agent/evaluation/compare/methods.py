"""The methods by name: each tuned as its book says on the first part of a recording, then run over all of it.

window-ml   not tuned: its configuration's window, noise learnt.
ekf, ukf    joint filters; the random walks of parameters and states that make the innovations most likely
            (Mehra, IEEE Trans. Automatic Control 15 (1970) 175; Bar-Shalom, Li & Kirubarajan, Estimation with
            Applications to Tracking and Navigation, 2001, ch. 5 and 11). The UKF takes those of the EKF: they
            mean the same.
rls         forgetting and observer poles that predict best what was not seen (Ljung, System Identification,
            2nd ed., 1999, ch. 11 and 16.6).
observer    the adaptive observer; poles two to six times faster than the plant's (Franklin, Powell & Workman,
            Digital Control of Dynamic Systems, 1998, ch. 8), its rate by the same prediction.
seed        the paper's method, re-centred, with the configuration's poles or such; it reads A and B only.
"""

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import product

import numpy as np

from agent.config.tables import Observer
from agent.errors import AgentError, UsageError
from agent.evaluation.compare import rivals
from agent.evaluation.compare.trial import Estimates, Trial
from agent.evaluation.tuning import (
    MEMORIES,
    METHOD_BLOCK,
    PARTS,
    POLES_APART,
    PUSHES,
    RATES,
    SLOWEST_SHARE,
    SPEEDS,
    TUNED_PARTS,
    WALKS,
)
from agent.numerics.model.observer import poles_gain
from agent.numerics.model.statespace import discretise
from agent.runtime.assembly.methods import make_estimation
from agent.types import FloatArray, Samples, Status

Run = Callable[[], Estimates]


class NotApplicableError(Exception):
    """A method cannot say anything of such a rig; the words say why."""


@dataclass(frozen=True, slots=True)
class Tuned:
    """A method ready to run, and what it was tuned to in words."""

    run: Run
    words: str


def tuned(name: str, trial: Trial) -> Tuned:
    """Return a method tuned on the trial's first part. Raises NotApplicableError."""
    try:
        return METHODS[name](trial)
    except (AgentError, np.linalg.LinAlgError, ValueError) as error:
        raise NotApplicableError(" ".join(str(error).split())) from error


def chosen(text: str | None) -> tuple[str, ...]:
    """Return the methods that --methods names, all of them without. Raises UsageError."""
    if text is None:
        return tuple(METHODS)
    names = [name.strip() for name in text.split(",") if name.strip()]
    unknown = [name for name in names if name not in METHODS]
    if unknown or not names:
        raise UsageError.at(
            "--methods", f'no method is called "{", ".join(unknown)}"', f"methods are {', '.join(METHODS)}"
        )
    return tuple(dict.fromkeys(names))


def _product(trial: Trial) -> Tuned:
    return Tuned(lambda: of_product(trial, trial.config.estimator.method), "not tuned")


def _seed(trial: Trial) -> Tuned:
    _require_direct(trial)
    poles = trial.config.estimator.observer.poles
    words = "the configuration's poles" if poles else f"poles {SPEEDS[1]:g} times the plant's"
    update = {
        "method": "seed", "window_s": trial.window * trial.period_s, "hold": trial.hold,
        "observer": Observer(gain="poles", poles=poles or tuple(_poles(trial, SPEEDS[1]))),
    }  # fmt: skip
    estimator = trial.config.estimator.model_copy(update=update)
    config = trial.config.model_copy(update={"estimator": estimator})
    seeded = Trial(config, trial.rig, trial.y, trial.u, trial.noise, trial.window, trial.size)
    return Tuned(lambda: of_product(seeded, "seed"), f"{words}, {estimator.passes} passes")


def of_product(trial: Trial, method: str) -> Estimates:
    """Run a method of the product as `replay` does."""
    inputs = trial.u[:, : len(trial.config.inputs) + len(getattr(trial.config.model, "friction", ()))]
    block = make_estimation(trial.config, np.zeros(trial.y.shape[1]))
    step = min(METHOD_BLOCK, -(-len(trial.y) // PARTS))
    batches = []
    marks = [time.process_time()]
    for start in range(0, len(trial.y), step):
        index = np.arange(start, min(start + step, len(trial.y)), dtype=np.int64)
        t_ns = (index * (1e9 * trial.period_s)).astype(np.int64)
        batches.append(block.step(Samples(index, t_ns, inputs[index], trial.y[index], segment=0)).batch)
        marks.append(time.process_time())
    rows = [batch for batch in batches if batch is not None]
    index, theta, sd, lower, upper, status = (
        np.concatenate([getattr(batch, name) for batch in rows])
        for name in ("index", "value", "sd", "lower", "upper", "status")
    )
    valid = np.isfinite(theta) if method == "seed" else status == Status.VALID
    first = len(batches) // TUNED_PARTS
    spent = (marks[-1] - marks[first]) / (len(trial.y) - first * step)
    return Estimates(index, theta, sd, lower, upper, valid, 1e6 * spent)


def _joint(trial: Trial, *, unscented: bool) -> Tuned:
    from agent.evaluation.compare import joint

    polynomial = _polynomial(trial)
    best = _most_likely(trial)
    run = joint.run_ukf if unscented else joint.run_ekf
    words = f"walk {best.walk:g}, push {best.push:g} a sample"
    return Tuned(lambda: tracked(lambda: run(polynomial, trial.noise, best, trial.y, trial.u)), words)


@lru_cache(maxsize=1)
def _most_likely(trial: Trial) -> rivals.Tuning:
    from agent.evaluation.compare import joint

    polynomial = _polynomial(trial)
    y, u = trial.y[trial.tuning], trial.u[trial.tuning]
    tunings = [rivals.Tuning(walk, push=push) for walk, push in product(WALKS, PUSHES)]
    with np.errstate(all="ignore"):  # a badly tuned filter runs away, and is scored as such
        scores = [joint.likelihood(polynomial, trial.noise, tuning, y, u) for tuning in tunings]
    return tunings[int(np.argmax(np.nan_to_num(scores, nan=-np.inf)))]


def _rls(trial: Trial) -> Tuned:
    _require_direct(trial)
    model = trial.rig.model

    def run(gain: FloatArray, memory: float, part: slice) -> Estimates:
        y, u = trial.y[part], trial.u[part]
        return tracked(
            lambda: rivals.run_rls(model, trial.period_s, gain, memory, y, u, trial.hold, trial.size)
        )

    choices = (
        (f"poles x {s:g}, forgets {m:g}", partial(run, _gain(trial, s), m)) for s in SPEEDS for m in MEMORIES
    )
    return _best(trial, choices)


def _observer(trial: Trial) -> Tuned:
    _require_direct(trial)
    polynomial = _polynomial(trial)

    def run(gain: FloatArray, rate: float, part: slice) -> Estimates:
        y, u = trial.y[part], trial.u[part]
        return tracked(lambda: rivals.run_observer(polynomial, gain, rate, trial.noise, y, u))

    choices = (
        (f"poles x {s:g}, rate {r:g}", partial(run, _gain(trial, s), r)) for s in SPEEDS for r in RATES
    )
    return _best(trial, choices)


def _best(trial: Trial, choices: Iterable[tuple[str, Callable[[slice], Estimates]]]) -> Tuned:
    """Return the choice that predicts the windows of the tuning part best."""
    starts = trial.scored(trial.tuning) or trial.scored()[:1]
    part = slice(0, max(trial.tuning.stop, starts[-1] + trial.window))
    scored = [(float(np.mean(trial.left(run(part), starts))), words, run) for words, run in choices]
    _, words, run = min(scored, key=lambda entry: entry[0])
    return Tuned(lambda: run(slice(0, len(trial.y))), words)


def tracked(track: Callable[[], rivals.Track]) -> Estimates:
    """Run a method that gives estimates after every sample, and take its time."""
    begun = time.process_time()
    with np.errstate(all="ignore"):  # a badly tuned filter runs away, and is scored as such
        theta, sd = track()
    spent = time.process_time() - begun
    half = 1.96 * sd
    index = np.arange(len(theta), dtype=np.int64)
    return Estimates(
        index, theta, sd, theta - half, theta + half, np.isfinite(theta), 1e6 * spent / len(theta)
    )


def _polynomial(trial: Trial) -> rivals.Polynomial:
    return rivals.Polynomial(trial.rig.model, trial.period_s, trial.hold, trial.size)


def _require_direct(trial: Trial) -> None:
    continuous = trial.rig.model.continuous(trial.nominal)
    if continuous.dC.any() or continuous.dD.any():
        raise ValueError(
            "its regression is of A and B; accelerometers and constants of outputs stand in C and D"
        )


def _poles(trial: Trial, speed: float) -> list[float]:
    """Return real poles so many times faster than the plant's, none equal."""
    sizes = np.sort(np.abs(np.linalg.eigvals(trial.rig.model.continuous(trial.nominal).A)))
    sizes = np.maximum(sizes, SLOWEST_SHARE * sizes.max())
    return [-speed * size * (1.0 + POLES_APART * i) for i, size in enumerate(sizes.tolist())]


def _gain(trial: Trial, speed: float) -> FloatArray:
    sampled = discretise(trial.rig.model.continuous(trial.nominal), trial.period_s, trial.hold).model
    return poles_gain(sampled, _poles(trial, speed), trial.period_s)


METHODS: Mapping[str, Callable[[Trial], Tuned]] = {
    "window-ml": _product,
    "ekf": partial(_joint, unscented=False),
    "ukf": partial(_joint, unscented=True),
    "rls": _rls,
    "observer": _observer,
    "seed": _seed,
}
