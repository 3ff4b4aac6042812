"""Machines without nominals, or with all of them 1, are identified within their intervals, or refused by
name; also those of which few motions, or accelerations only, are measured."""

import time
from pathlib import Path

import numpy as np
import pytest

from agent.commissioning.identification.identify import identify
from tests.figures import figure
from tests.statistical.unknown_machines import SPAN_S, accelerations, one_of_two, written


def is_right(folder: Path, seed: int, nominal: str, share_of_span: float) -> bool:
    """Tell whether a machine's values are within 3 sd and 2 % of the truth, in a share of the data's span.

    The time is the processor's: on the wall's clock a machine takes as long as others beside it want it to.
    """
    one, config, recording = written(folder, seed, nominal)
    began = time.process_time()
    document, _ = identify(config=config, recordings=[recording])
    seconds = time.process_time() - began
    rows = document["parameters"]
    errors = {name: rows[name]["value"] - true for name, true in one.truth.items()}
    shares = {name: abs(error) / one.truth[name] for name, error in errors.items()}
    sds = {name: abs(error) / rows[name]["sd"] for name, error in errors.items()}
    figure(
        f"machine {seed}: {len(one.masses)} masses, {100 * max(shares.values()):.2f} %, "
        f"{max(sds.values()):.1f} sd, "
        f"{document['unexplained_percent']:.3f} % unexplained, {seconds:.1f} s of {SPAN_S:.0f} s"
    )
    recording.unlink()
    in_time = seconds < share_of_span * SPAN_S
    return document["ok"] and max(shares.values()) < 0.02 and max(sds.values()) < 3.0 and in_time


@pytest.mark.parametrize("nominal", ["", ", nominal = 1.0"], ids=["no nominals", "all 1"])
def test_four_unknown_machines_are_identified(tmp_path: Path, nominal: str) -> None:
    assert sum(is_right(tmp_path, seed, nominal, 0.1) for seed in range(4)) == 4


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("nominal", ["", ", nominal = 1.0"], ids=["no nominals", "all 1"])
def test_forty_unknown_machines_are_identified(tmp_path: Path, nominal: str) -> None:
    assert sum(is_right(tmp_path, 100 + seed, nominal, 0.1) for seed in range(40)) >= 38


SENSING = {"one displacement of two": one_of_two, "accelerometers": lambda one, _: accelerations(one)}


def is_right_of_few(folder: Path, seed: int, kind: str) -> bool:
    """Tell whether a machine that few sensors watch is right within 3 sd and 2 %."""
    one, config, recording = written(folder, seed, sensing=SENSING[kind])
    began = time.process_time()
    document, _ = identify(config=config, recordings=[recording])
    seconds = time.process_time() - began
    rows = document["parameters"]
    errors = {name: rows[name]["value"] - true for name, true in one.truth.items()}
    share = max(abs(error) / one.truth[name] for name, error in errors.items())
    sds = max(abs(error) / rows[name]["sd"] for name, error in errors.items())
    vague = [name for name, row in rows.items() if row["why"]]
    figure(
        f"machine {seed}, {kind}: {len(one.masses)} masses, {100 * share:.2f} %, {sds:.1f} sd, "
        f"{document['unexplained_percent']:.3f} % unexplained, {seconds:.1f} s of processor, unknown {vague}"
    )
    recording.unlink()
    return document["ok"] and share < 0.02 and sds < 3.0


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", list(SENSING))
def test_twenty_machines_with_few_sensors_are_identified(tmp_path: Path, kind: str) -> None:
    assert sum(is_right_of_few(tmp_path, 300 + seed, kind) for seed in range(20)) >= 17


@pytest.mark.parametrize("seed", [614, 616, 618, 632])
def test_short_record_of_a_single_accelerometer_is_identified_where_a_step_of_half_an_sd_is_left(
    tmp_path: Path, seed: int
) -> None:
    one, config, recording = written(tmp_path, seed, masses=1, sensing=SENSING["accelerometers"], span_s=8.0)
    document, _ = identify(config=config, recordings=[recording])
    assert document["ok"], document["errors"]
    rows = document["parameters"]
    assert all(abs(rows[name]["value"] - true) < 3.0 * rows[name]["sd"] for name, true in one.truth.items())


@pytest.mark.parametrize("seed", [0, pytest.param(5, marks=pytest.mark.soak)])
def test_wrong_graph_is_refused_by_name(tmp_path: Path, seed: int) -> None:
    _, config, recording = written(tmp_path, seed, masses=3, without=0)
    before = config.read_bytes()
    document, _ = identify(config=config, recordings=[recording], write=True)
    assert not document["ok"]
    message = document["errors"][0]["message"]
    assert "% of the motion of x" in message or "the graph fits only with" in message, message
    assert "where the file says" not in document["errors"][0]["advice"]
    assert config.read_bytes() == before
    assert np.isfinite(document["unexplained_percent"])


@pytest.mark.parametrize(
    ("channels", "factor", "said"),
    [
        (["x1"], 1e3, "it fits with x1 in mm where the file says m: correct"),
        pytest.param(
            ["x1", "x2", "x3", "x4"],
            1e3,
            "; or x1, x2, x3, x4 in mm where the file says m: correct",
            marks=pytest.mark.soak,
        ),
        pytest.param(
            ["f4"],
            1 / 9.80665,
            "it fits with f4 in kgf where the file says N: correct",
            marks=pytest.mark.soak,
        ),
    ],
)
def test_channels_in_another_unit_are_named_with_it(
    tmp_path: Path, channels: list[str], factor: float, said: str
) -> None:
    _, config, recording = written(tmp_path, 2)
    with np.load(recording) as columns:
        read = {name: factor * v if name in channels else v for name, v in columns.items()}
    np.savez(recording, **read)
    document, _ = identify(config=config, recordings=[recording])
    assert not document["ok"]
    assert said in document["errors"][0]["advice"]
