"""Prometheus' own tool holds nothing against what the agent serves, nor against the rules that come along."""

import subprocess
import urllib.request
from pathlib import Path

import pytest
from prometheus_client.exposition import generate_latest
from prometheus_client.registry import CollectorRegistry

from agent.runtime.telemetry.metrics import FIGURES, AgentCollector
from tests import figures, peers
from tests.ports import free_port
from tests.scenario.live import agent, example, rows, wait_until
from tests.scenario.test_conservation import scenario
from tests.sim.rigs import simulator
from tests.unit.runtime.test_metrics import status, values

RULES = peers.ROOT / "deploy/prometheus/deltak.rules.yml"
FAULTS = {
    "drop": (3.0, 3.05), "duplicate": (5.0, 5.07), "reorder": (6.0, 6.001), "corrupt": (8.0, 8.2),
    "garbage": (8.5, 8.6),
}  # fmt: skip
COUNTS = "SELECT received, used, rejected, dropped, gaps FROM v_health ORDER BY t_ns DESC LIMIT 1"
REASONS = """SELECT kind, reason, count FROM v_health_reasons WHERE count > 0 AND kind <> 'faults'
 AND t_ns = (SELECT max(t_ns) FROM v_health)"""


def promtool(*words: str, given: bytes = b"") -> str:
    """Return what promtool says where it finds a fault; nothing where it finds none."""
    tool = peers.program("promtool", "prometheus")
    done = subprocess.run([tool, *words], input=given, capture_output=True, timeout=60, check=False)
    return "" if done.returncode == 0 and not done.stderr else (done.stdout + done.stderr).decode()


def test_promtool_takes_what_the_agent_serves_without_a_word() -> None:
    registry = CollectorRegistry(auto_describe=False)
    registry.register(AgentCollector(status))
    served = generate_latest(registry)
    assert all(name.removesuffix("_total").encode() in served for name in FIGURES)
    assert promtool("check", "metrics", given=served) == ""
    assert promtool("check", "metrics", given=served.replace(b"deltak_uptime_seconds", b"deltak_uptime_ms"))


def test_promtool_takes_the_rules_and_each_fires_when_it_should() -> None:
    assert promtool("check", "rules", "--lint-fatal", str(RULES)) == ""
    tests = Path(__file__).with_name("rules_test.yml")
    assert promtool("test", "rules", str(tests)) == ""
    named = tests.read_text(encoding="utf-8")
    alerts = [line.split()[-1] for line in RULES.read_text(encoding="utf-8").splitlines() if "alert:" in line]
    assert [alert for alert in alerts if f"alertname: {alert}\n" not in named] == []


@pytest.mark.soak
@pytest.mark.realtime
def test_counters_of_a_scrape_are_those_of_v_health_while_frames_are_lost_and_broken(tmp_path: Path) -> None:
    port, db = free_port(), tmp_path / "agent.db"
    text = example("serial", tmp_path).read_text() + f'\n[metrics]\nlisten = "127.0.0.1:{port}"\n'
    faults = scenario(tmp_path, "serial", FAULTS)
    faults.write_text(faults.read_text().replace("duration_s = 2.0", "duration_s = 60.0"))

    def scraped() -> str:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=5.0) as answer:
            return str(answer.read().decode())

    def served() -> dict[tuple[str, ...], float]:
        """The counters by fate and reason."""
        found = {
            name: value for name, value in values(scraped()).items() if name[0].startswith("deltak_sample")
        }
        return {(name[0], *sorted(set(name[1:]) - {"", "serial", rig})): n for name, n in found.items()}

    def stored() -> dict[tuple[str, ...], float]:
        ((received, used, _, _, gaps),) = rows(db, COUNTS)
        counts = {(kind, reason): count for kind, reason, count in rows(db, REASONS)}
        return {
            ("deltak_samples_received_total",): received, ("deltak_samples_total", "used"): used,
            ("deltak_sample_gaps_total",): gaps,
            **{("deltak_samples_total", *sorted(key)): count for key, count in counts.items()},
        }  # fmt: skip

    rig = "two-mass-rig"
    with (
        simulator(tmp_path, text, "--scenario", str(faults)) as device,
        agent(device.config, options=["--db", str(db)]),
    ):
        wait_until(lambda: bool(found := rows(db, COUNTS)) and found[0][0] > 15_000, "two ledgers", 40)
        wait_until(lambda: served() == stored(), "the ledger to be served", 5)
        assert promtool("check", "metrics", given=scraped().encode()) == ""
        found = stored()
    assert found["deltak_samples_total", "duplicate", "rejected"] == 70
    assert len(found) >= 6
    received = found["deltak_samples_received_total",]
    figures.figure(f"counters of a scrape equal v_health: {received:.0f} samples, {len(found)} counters")
