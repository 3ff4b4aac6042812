"""With several windows the file holds what each of them says, and which one was chosen."""

from pathlib import Path

import numpy as np
import pytest

from agent.evaluation.demo.bus import COARSE, write_config
from agent.runtime.replay import replay
from agent.storage.maintenance import check
from agent.storage.write.decimation import Thinner
from tests.rigs import two_mass_recording
from tests.scenario.live import rows
from tests.storage.rows import batch

WINDOWS = (0.25, 0.5, 1.0)


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("windows")
    config = write_config("modbus", COARSE, folder).config
    text = config.read_text(encoding="utf-8").replace("window_s = 0.25", f"window_s = {list(WINDOWS)}")
    config.write_text(text, encoding="utf-8")
    two_mass_recording(folder / "rig.csv", np.random.default_rng(3))
    document = replay(config=config, recordings=[folder / "rig.csv"], db=folder / "rig.db")
    assert document["windows"] == 60
    return folder / "rig.db"


def test_file_of_several_windows_holds_the_rows_of_each_and_marks_the_chosen_one(stored: Path) -> None:
    found = rows(stored, "SELECT t_ns, parameter, count(*), sum(chosen), count(DISTINCT window_s) "
                 "FROM v_estimates_windows GROUP BY t_ns, parameter")  # fmt: skip
    assert all(chosen == 1 and count == windows for _, _, count, chosen, windows in found)
    counts = [count for _, name, count, _, _ in found if name == "k1"]
    assert (counts[0], counts[-1], max(counts)) == (1, 3, 3)
    assert rows(stored, "SELECT count(*) FROM v_estimates") == [(240,)]
    assert {w for (w,) in rows(stored, "SELECT DISTINCT window_s FROM v_estimates_windows")} == set(WINDOWS)
    assert check(stored).problems == []


def test_longer_window_that_a_change_lies_in_is_not_called_valid(stored: Path) -> None:
    """At sample 1249 the window of 0.25 s is the first that holds nothing of what was before the change at
    1000."""
    query = (
        "SELECT window_s, chosen, status FROM v_estimates_windows WHERE parameter = 'k1' "
        "AND t_ns = (SELECT min(t_ns) FROM v_estimates) + 1200000000 ORDER BY window_s"
    )
    assert rows(stored, query) == [(0.25, 1, "valid"), (0.5, 0, "invalid"), (1.0, 0, "invalid")]


def test_thinner_keeps_of_every_window_the_same_instants() -> None:
    whole = batch(100, others=(batch(100, value=np.full((100, 4), 7.0)),))
    thinner = Thinner(1.0)
    kept = [*thinner.feed([whole]), *thinner.flush()]
    assert sum(len(r) for r in kept) == 5
    assert all(np.array_equal(r.t_ns, r.others[0].t_ns) and (r.others[0].value == 7.0).all() for r in kept)
