"""Two hundred rigs of one agent, whose folder of configurations is treated badly while it runs."""

import os
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from agent.cli.gateway.status import reload, status
from agent.errors import ConfigError, StoreError
from tests.figures import figure
from tests.scenario.live import EXAMPLES, Agent, agent, rows, wait_until

pytestmark = [pytest.mark.realtime, pytest.mark.soak, pytest.mark.timeout(900)]
RIGS = 200
STORM = 500
QUIET = ("sh", "-c", 'exec "$@" 2>/dev/null', "sh")
"""Hundreds of lines are more than a pipe holds that nobody reads."""


class Many:
    """An agent of many rigs whose devices are all away."""

    def __init__(self, folder: Path) -> None:
        self._text = (EXAMPLES / "modbus.toml").read_text(encoding="utf-8")
        self.folder, self.db = folder / "conf.d", folder / "all.db"
        self.folder.mkdir()
        for number in range(RIGS):
            self.write(number)

    def write(self, number: int, limit: str = "15.0") -> Path:
        text = self._text.replace('"two-mass-rig"', f'"rig{number}"').replace(
            "limit = 15.0", f"limit = {limit}"
        )
        text = text.replace('"two-mass-rig.db"', '"../all.db"').replace(
            "port = 1502", f"port = {20000 + number}"
        )
        file = self.folder / f"rig{number}.toml"
        file.write_text(text + "\n[agent]\nworkers = 1\n")
        return file

    def treated_badly(self) -> dict[str, Callable[[], object]]:
        """Return what is done to the folder or a file of it, by what the refusal says."""
        other, own = self.folder / "other.toml", self.folder / "rig3.toml"
        found: dict[str, Callable[[], object]] = {
            "No such file": lambda: other.symlink_to("/nowhere/rig.toml"),
            "symbolic links": lambda: other.symlink_to("other.toml"),
            "is no file": lambda: os.mkfifo(other),
            "is the rig of": lambda: shutil.copy(own, other),
            "is not TOML": lambda: own.write_text(own.read_text().partition("delay_s")[0]),
            "is missing": lambda: own.write_text(""),
        }
        if os.geteuid() != 0:
            found["Permission denied"] = lambda: own.chmod(0)
        return found

    def mend(self) -> None:
        (self.folder / "other.toml").unlink(missing_ok=True)
        (self.folder / "rig3.toml").unlink()
        self.write(3)


def threads(running: Agent) -> int:
    lines = Path(f"/proc/{running.process.pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("Threads:"))


def refusals(many: Many) -> int:
    query = "SELECT count(*) FROM v_events WHERE cause = 'refused' AND rig = 'rig0'"
    return int(rows(many.db, query)[0][0])


def answers(many: Many) -> bool:
    try:
        return len(status(many.db)["rigs"]) == RIGS
    except StoreError:
        return False


def test_two_hundred_rigs_live_through_a_folder_treated_badly_and_a_storm_of_signals(tmp_path: Path) -> None:
    many = Many(tmp_path)
    with agent(many.folder, wrapper=QUIET) as running:
        wait_until(lambda: answers(many), "all rigs", 300)
        for words, harm in many.treated_badly().items():
            harm()
            with pytest.raises(ConfigError, match=words):
                reload(many.db)
            many.mend()
        assert set(map(len, reload(many.db).values())) == {0, RIGS}
        (many.folder / "rig5.toml").unlink()
        assert reload(many.db)["removed"] == ["rig5"]
        many.write(5)
        assert reload(many.db)["added"] == ["rig5"]
        (many.folder / "rig3.toml").write_text("")  # so that each reload leaves an event
        before, most, refused = threads(running), 0, refusals(many)
        for _ in range(STORM):
            running.process.send_signal(signal.SIGHUP)
            most = max(most, threads(running))
        wait_until(lambda: refusals(many) > refused, "the storm to be heard", 120)
        with pytest.raises(ConfigError, match="is missing"):
            reload(many.db)
        for number in range(RIGS):
            many.write(number, "16.0")
        assert len(reload(many.db)["restarted"]) == RIGS
        assert running.end(signal.SIGTERM) == 0
    stormed = refusals(many) - len(many.treated_badly()) - 1
    assert 1 <= stormed <= 4
    assert most <= before + 4  # what answers commands comes and goes
    figure(f"{RIGS} rigs: {before} threads; {STORM} signals were {stormed} reloads")
