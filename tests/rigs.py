"""Recordings of a rig that the tests integrate by themselves, by neither agent nor simulator."""

from pathlib import Path

import numpy as np
from scipy.linalg import expm

MASSES = (5.0, 3.0)
SCHEDULE = ((50.0, 150.0, 5.0, 5.0), (25.0, 100.0, 2.0, 2.0), (75.0, 75.0, 5.0, 5.0))
"""(k1, k2, B1, B2) in each second."""


def step_matrices(
    k1: float, k2: float, B1: float, B2: float, h: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return F, G0, G1 of x(i+1) = F x(i) + G0 u(i) + G1 u(i+1), exact for a force on m2 that is linear
    between."""
    m1, m2 = MASSES
    M = np.zeros((6, 6))
    M[0, 2] = M[1, 3] = 1.0
    M[2, :4] = np.array([-(k1 + k2), k2, -(B1 + B2), B2]) / m1
    M[3, :4] = np.array([k2, -k2, B2, -B2]) / m2
    M[3, 4] = 1.0 / m2
    M *= h
    M[4, 5] = 1.0
    E = expm(M)
    return E[:4, :4], E[:4, 4] - E[:4, 5], E[:4, 5]


def two_mass_recording(path: Path, rng: np.random.Generator, seconds: int = 3) -> None:
    """Write a CSV recording of the two masses at 1 kHz under a random force, quantised as 16 bits would."""
    n, x, rows = 1000 * seconds, np.zeros(4), []
    u = rng.normal(0.0, 5.0, n + 1)
    for i in range(n):
        if i % 1000 == 0:
            F, G0, G1 = step_matrices(*SCHEDULE[i // 1000 % 3], 1e-3)
        read = np.round((x[:2] + rng.normal(0.0, 1e-6, 2)) / 2e-6) * 2e-6
        rows.append(f"{i / 1000:.3f},{u[i]:.3f},{read[0]:.6f},{read[1]:.6f}")
        x = F @ x + G0 * u[i] + G1 * u[i + 1]
    path.write_text("\n".join(["t,force,x1,x2", *rows, ""]), encoding="utf-8")
