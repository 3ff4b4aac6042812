"""The linear kind from other energy domains: each example follows what the test's own simulation changes."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tests.replay.records import replayed

FloatArray = NDArray[np.float64]
Physics = Callable[[FloatArray, FloatArray, dict[str, float]], list[float]]


def motor(x: FloatArray, u: FloatArray, p: dict[str, float]) -> list[float]:
    i, w = x
    return [(u[0] - p["R"] * i - p["K"] * w) / 2e-3, (p["K"] * i - p["b"] * w) / 2e-4]


def cabinet(x: FloatArray, u: FloatArray, p: dict[str, float]) -> list[float]:
    across = p["G12"] * (x[0] - x[1])
    return [(u[0] - across) / 500.0, (across - p["G2"] * (x[1] - u[1])) / 1500.0]


def tanks(x: FloatArray, u: FloatArray, p: dict[str, float]) -> list[float]:
    across = p["c12"] * (x[0] - x[1])
    return [(u[0] - across) / 0.05, (across - p["c2"] * x[1]) / 0.08]


@dataclass(frozen=True)
class Domain:
    """One example: its physics, healthy and changed values, and how it is driven."""

    example: str
    physics: Physics
    columns: str
    healthy: dict[str, float]
    changed: dict[str, float]
    period_s: float
    samples: int
    noise: tuple[float, float]
    held: bool
    drive: Callable[[FloatArray, np.random.Generator], FloatArray]
    start: tuple[float, float]


def steps(t: FloatArray, rng: np.random.Generator, every: int, low: float, high: float) -> FloatArray:
    """Return an input (N,) that jumps to a random level every so many samples."""
    return np.repeat(rng.uniform(low, high, len(t) // every + 1), every)[: len(t)]


DOMAINS = [
    Domain(
        "dc_motor.toml", motor, "t,voltage,current,speed", {"R": 1.0, "K": 0.05, "b": 1e-3},
        {"R": 1.2, "K": 0.05, "b": 1e-3}, 5e-4, 12_000, (0.02, 0.2), False,
        lambda t, _: np.stack([12.0 + 6.0 * np.sin(11.0 * t) + 4.0 * np.sin(47.0 * t + 1.0)], axis=1),
        (6.0, 180.0),
    ),
    Domain(
        "thermal_rc.toml", cabinet, "t,power,room,core,shell", {"G12": 2.0, "G2": 0.5},
        {"G12": 2.0, "G2": 0.38},
        5.0, 12_000, (0.05, 0.05), True,
        lambda t, rng: np.stack([steps(t, rng, 240, 0.0, 60.0), steps(t, rng, 700, 18.0, 24.0)], axis=1),
        (60.0, 50.0),
    ),
    Domain(
        "coupled_tanks.toml", tanks, "t,flow,h1,h2", {"c12": 4e-3, "c2": 2e-3}, {"c12": 3.2e-3, "c2": 2e-3},
        1.0, 8000, (1e-3, 1e-3), True,
        lambda t, rng: np.stack([steps(t, rng, 60, 2e-4, 1.2e-3)], axis=1), (0.4, 0.3),
    ),
]  # fmt: skip


def play(domain: Domain, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return t, u, y of a run whose parameters change half-way, integrated sample by sample to 1e-9."""
    t = np.arange(domain.samples) * domain.period_s
    u, x = domain.drive(t, rng), np.array(domain.start)
    y = np.empty((len(t), 2))
    for k in range(len(t)):
        y[k] = x
        p = domain.healthy if k < domain.samples // 2 else domain.changed
        slope = (
            np.zeros(u.shape[1]) if domain.held or k + 1 == len(t) else (u[k + 1] - u[k]) / domain.period_s
        )
        x = integrated(domain.physics, x, u[k], slope, p, domain.period_s)
    return t, u, y + rng.normal(0.0, domain.noise, y.shape)


def integrated(
    physics: Physics, x: FloatArray, u: FloatArray, slope: FloatArray, p: dict[str, float], period_s: float
) -> FloatArray:
    """Return the state a sample later by four Runge-Kutta steps of fourth order."""
    h = period_s / 4
    for i in range(4):
        at = [u + slope * (i + c) * h for c in (0.0, 0.5, 1.0)]
        k1 = np.array(physics(x, at[0], p))
        k2 = np.array(physics(x + 0.5 * h * k1, at[1], p))
        k3 = np.array(physics(x + 0.5 * h * k2, at[1], p))
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + np.array(physics(x + h * k3, at[2], p)))
    return x


def test_integration_agrees_with_an_adaptive_solver() -> None:
    p, x, u = DOMAINS[0].healthy, np.array([2.0, 50.0]), np.array([9.0])
    known = solve_ivp(lambda _, s: motor(s, u, p), (0.0, 5e-4), x, rtol=1e-12, atol=1e-12).y[:, -1]
    assert np.allclose(integrated(motor, x, u, np.zeros(1), p, 5e-4), known, rtol=1e-5)


@pytest.mark.parametrize("domain", DOMAINS, ids=lambda d: d.example.removesuffix(".toml"))
def test_linear_example_finds_the_change_with_honest_intervals(domain: Domain, tmp_path: Path) -> None:
    t, u, y = play(domain, np.random.default_rng(7))
    table = np.column_stack([t, u, y])
    recording = tmp_path / "played.csv"
    np.savetxt(recording, table, delimiter=",", header=domain.columns, comments="", fmt="%.9g")
    found = replayed(domain.example, recording, tmp_path)
    half = t[domain.samples // 2]
    moved = [name for name in domain.healthy if domain.healthy[name] != domain.changed[name]]
    assert sorted({alarm["parameter"] for alarm in found.document["alarms"]}) == moved
    for name in domain.healthy:
        for truth, rows in (
            (domain.healthy[name], [r for r in found.of(name) if r["t_ns"] / 1e9 < half]),
            (
                domain.changed[name],
                [r for r in found.of(name) if r["t_ns"] / 1e9 > half + 1.1 * r["window_s"]],
            ),
        ):
            valid = [r for r in rows if r["status"] == "valid"]
            assert len(valid) > 0.9 * len([r for r in rows if r["status"] != "warming"]), name
            inside = np.mean([r["lower"] <= truth <= r["upper"] for r in valid])
            errors = [abs(r["value"] - truth) / r["sd"] for r in valid]
            assert inside > 0.8, (name, inside)
            assert max(errors) < 5.0, name
