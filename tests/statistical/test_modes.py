"""Modes of an identified machine are those that subspace identification and experimental modal analysis find.

The peers know nothing of the graph: N4SID (nfoursid) fits any linear system to the readings, and a
least-squares complex frequency fit (sdypy-EMA) to frequency responses. All three speak of the same poles.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import sdypy.EMA
from nfoursid.nfoursid import NFourSID
from scipy.signal import csd, welch

from agent.commissioning.identification.identify import identify
from agent.types import ComplexArray, FloatArray
from tests.figures import figure
from tests.statistical.unknown_machines import Machine, configuration, recorded

TRUTH = Machine(
    np.array([2.0, 1.5, 1.0]), ((0, 1), (1, 2), (2, 3)), np.array([900.0, 700.0, 500.0]),
    np.array([3.6, 2.8, 2.0]), (3,),
)  # fmt: skip
OUTPUTS = ("x1", "x2", "x3")
SPAN_S, NOISE = 240.0, 1e-3
BLOCK_ROWS, FITTED = 15, 4000
SEGMENT, ORDER, ABOVE = 8192, 20, 8.0
HERTZ = 100.0
"""Factor on the frequencies shown to sdypy-EMA, which looks for poles in steps of whole hertz."""


def modes(poles: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return frequencies (n,), Hz, rising, and damping ratios (n,) of poles in 1/s."""
    upper = np.asarray(poles)[np.imag(poles) > 0]
    upper = upper[np.argsort(np.abs(upper))]
    return np.abs(upper) / (2 * np.pi), -upper.real / np.abs(upper)


@pytest.fixture(scope="module")
def columns() -> dict[str, FloatArray]:
    return recorded(TRUTH, np.random.default_rng(4), NOISE, span_s=SPAN_S)


@pytest.fixture(scope="module")
def ours(
    columns: dict[str, FloatArray], tmp_path_factory: pytest.TempPathFactory
) -> tuple[FloatArray, FloatArray]:
    """Modes of the machine with the springs and dampers that `identify` finds; masses and gains are exact."""
    folder = tmp_path_factory.mktemp("modes")
    text = re.sub(r"(value = [\d.]+)", r"\1, sd_percent = 0", configuration(TRUTH, columns, TRUTH.masses))
    (folder / "rig.toml").write_text(text.replace("[[channel]]", "[[channel]]\ngain_sd_percent = 0"))
    np.savez(folder / "record.npz", **columns)
    found, _ = identify(config=folder / "rig.toml", recordings=[Path(folder / "record.npz")])
    k, B = (
        np.array([found["parameters"][f"{letter}{i}"]["value"] for i in (1, 2, 3)]) for letter in ("k", "B")
    )
    return modes(np.linalg.eigvals(replace(TRUTH, k=k, B=B).generator()))


def test_modes_are_the_poles_of_subspace_identification(
    columns: dict[str, FloatArray], ours: tuple[FloatArray, FloatArray]
) -> None:
    table = pd.DataFrame({name: columns[name] / columns[name].std() for name in ("f3", *OUTPUTS)})
    table["next f3"] = np.append(table["f3"].to_numpy()[1:], 0.0)  # it runs straight from sample to sample
    peer = NFourSID(
        table.iloc[:FITTED], output_columns=list(OUTPUTS), input_columns=["f3", "next f3"],
        num_block_rows=BLOCK_ROWS,
    )  # fmt: skip
    peer.subspace_identification()
    system, _ = peer.system_identification(rank=2 * len(TRUTH.masses))
    rate = 1.0 / columns["t"][1]
    hertz, damping = modes(rate * np.log(np.linalg.eigvals(system.a).astype(complex)))
    compared("subspace identification", ours, hertz, damping)
    np.testing.assert_allclose(hertz, ours[0], rtol=3e-4)
    np.testing.assert_allclose(damping, ours[1], rtol=0.01)


def test_modes_are_those_of_modal_analysis(
    columns: dict[str, FloatArray], ours: tuple[FloatArray, FloatArray]
) -> None:
    rate = 1.0 / columns["t"][1]
    hertz, force = welch(columns["f3"], rate, nperseg=SEGMENT)
    responses = [csd(columns["f3"], columns[name], rate, nperseg=SEGMENT)[1] / force for name in OUTPUTS]
    peer = sdypy.EMA.Model(
        frf=np.array(responses), freq=HERTZ * hertz, lower=HERTZ * 0.3 * ours[0][0],
        upper=HERTZ * ABOVE * ours[0][-1], pol_order_high=ORDER, frf_form="receptance",
    )  # fmt: skip
    peer.get_poles(method="lscf", show_progress=False)
    peer.select_closest_poles(list(HERTZ * ours[0]), fn_temp=0.01, xi_temp=0.1)
    compared("modal analysis", ours, np.array(peer.nat_freq) / HERTZ, np.array(peer.nat_xi))
    np.testing.assert_allclose(np.array(peer.nat_freq) / HERTZ, ours[0], rtol=1e-3)
    np.testing.assert_allclose(peer.nat_xi, ours[1], rtol=0.1)


def compared(peer: str, ours: tuple[FloatArray, FloatArray], hertz: FloatArray, damping: FloatArray) -> None:
    """Say how far a peer's modes are from ours."""
    away = 100 * np.abs(hertz / ours[0] - 1).max(), 100 * np.abs(damping / ours[1] - 1).max()
    figure(f"modes by {peer}: frequencies within {away[0]:.3f} %, damping within {away[1]:.1f} %")
