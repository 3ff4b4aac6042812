"""`check --plot`: where (3) holds and fails, the poles over the region, today's estimate from a database."""

from pathlib import Path

import numpy as np
import pytest

from agent.blocks.rig_model import rig_model
from agent.commissioning.check import check
from agent.commissioning.regions.picture import draw_region
from agent.commissioning.regions.places import newest, plane, poles_over
from agent.config import parse
from agent.errors import UsageError
from agent.storage.write.store import Store
from tests.peers import ROOT
from tests.storage.rows import batch, run_info

TEXT = (ROOT / "deploy/examples/serial.toml").read_text()
LIMITS = """
[[alarm]]
parameter = "B1"
limit_percent = 50.0
[[alarm]]
parameter = "B2"
limit_percent = 50.0
"""
RIG = TEXT.partition("[[alarm]]")[0].replace("two-mass-rig", "press-7") + LIMITS


def test_plane_shows_where_the_model_is_not_stable_and_poles_stay_within_the_worst_radius() -> None:
    config = parse(RIG.encode(), Path("rig.toml"))
    rig = rig_model(config)
    gain = np.zeros((4, 2))
    found = plane(config, rig, gain, rig.model.nominal)
    assert found is not None
    assert [rig.parameters[i].name for i in found.numbers] == ["k1", "B1"]
    # down to minus half the nominal damping
    assert np.all(found.radius[0] > 1.0)
    assert np.all(found.radius[-1] < 1.0)
    assert np.all(np.abs(poles_over(config, rig, gain)[0]) < 1.0)


def test_picture_holds_the_newest_estimate_of_a_database(tmp_path: Path) -> None:
    file, db, picture = tmp_path / "rig.toml", tmp_path / "rig.db", tmp_path / "region.svg"
    file.write_text(RIG)
    with Store.open(db) as store:
        store.write(store.begin_run(run_info()), [batch(3)])
    rig = parse(file.read_bytes(), file)
    today = newest(rig, rig_model(rig), db)
    assert np.all(np.isfinite(today.theta))
    document = check(config=file, recording=None, probe=False, progress=lambda _: None)
    draw_region(file, document, picture, db)
    assert f"estimate of {today.time[:19]}" in picture.read_text()


def test_picture_without_rows_of_the_rig_or_of_an_unknown_format_says_so(tmp_path: Path) -> None:
    file, db = tmp_path / "rig.toml", tmp_path / "rig.db"
    file.write_text(RIG)
    with Store.open(db) as store:
        store.begin_run(run_info())
    config = parse(file.read_bytes(), file)
    with pytest.raises(UsageError, match="no valid estimate of"):
        newest(config, rig_model(config), db)
    with pytest.raises(UsageError, match="no such format"):
        draw_region(file, {}, tmp_path / "region.xyz", None)
