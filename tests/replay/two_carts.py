"""Two carts on springs simulated freely from rest, by none of the product's code."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

RATE_HZ, COUNTS_A_VOLT = 887.1, 819.2


def free_run_fit(record: Path, values: dict[str, float]) -> NDArray[np.float64]:
    """Return 100 (1 - |y - simulated| / |y - mean|) of both carts, in percent, from the record's effort
    alone."""
    table = np.genfromtxt(record, skip_header=1, delimiter="\t")
    y, u = table[:, 2:4], table[:, 4] / COUNTS_A_VOLT
    v = values
    generator = np.zeros((5, 5))
    generator[0, 2] = generator[1, 3] = 1.0
    generator[2, :3] = np.array([-(v["k1"] + v["k2"]), v["k2"], -v["B1"]]) / v["m1"]
    generator[3, :2], generator[3, 3] = np.array([v["k2"], -v["k2"]]) / v["m2"], -v["B2"] / v["m2"]
    generator[2, 4] = 1.0 / v["m1"]
    step = expm(generator / RATE_HZ)
    x, places = np.zeros(4), np.empty_like(y)
    for k, force in enumerate(u):
        places[k] = x[:2]
        x = step[:4, :4] @ x + step[:4, 4] * force
    places += [v["x1.bias"], v["x2.bias"]]
    left = np.linalg.norm(y - places, axis=0) / np.linalg.norm(y - y.mean(axis=0), axis=0)
    return np.asarray(100.0 * (1.0 - left))
