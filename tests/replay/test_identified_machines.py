"""Recorded plants whose springs, dampers and friction nobody states: identify finds the published figures."""

import re
from pathlib import Path

from agent.commissioning.identification.identify import identify
from tests.figures import figure
from tests.peers import ROOT, data
from tests.replay.test_real_ecp210 import REFERENCE

PUBLISHED = {
    "M": (95.1089, 0.05),
    "Fv": (203.5034, 0.03),
    "Fc": (20.3935, 0.03),
    "force.bias": (-3.1648, 0.03),
}
NEAR = {"m1": 0.06, "m2": 0.06, "k1": 0.05, "k2": 0.05, "B1": 0.15, "B2": 0.15}


def without_nominals(example: str, folder: Path) -> Path:
    text = (ROOT / "deploy" / "examples" / example).read_text(encoding="utf-8")
    text, count = re.subn(r", nominal = [\d.e-]+", "", text)
    assert count >= 2
    config = folder / example
    config.write_text(text, encoding="utf-8")
    return config


def test_emps_without_nominals_comes_to_the_published_figures(tmp_path: Path) -> None:
    config = without_nominals("emps.toml", tmp_path)
    document, _ = identify(config=config, recordings=[data("emps/emps.csv")])
    assert document["ok"]
    assert document["unexplained_percent"] < 0.5
    for name, (published, share) in PUBLISHED.items():
        row = document["parameters"][name]
        figure(f"EMPS identified {name}: {row['value']:.4g} +- {row['sd']:.2g}, published {published}")
        assert abs(row["value"] / published - 1.0) < share, name
        assert abs(row["value"] - published) < 3 * row["sd"], name


def test_ecp210_without_nominals_comes_to_the_reference(tmp_path: Path) -> None:
    config = without_nominals("ecp210.toml", tmp_path)
    recordings = [data(f"ecp210/both_free_{run}.txt") for run in ("a", "b")]
    document, _ = identify(config=config, recordings=recordings)
    assert document["ok"]
    for name, reference in REFERENCE.items():
        row = document["parameters"][name]
        figure(f"ECP-210 identified {name}: {row['value']:.4g} +- {row['sd']:.2g}, reference {reference}")
        assert abs(row["value"] / reference - 1.0) < NEAR[name], name
        assert abs(row["value"] - reference) < 3 * row["sd"], name
