"""Metrics: what a scrape holds against the status it is made of; files and dashboards name metrics that
exist."""

import json
import re
import urllib.request
from pathlib import Path
from typing import Any

import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import CollectorRegistry

from agent.config import Metrics, parse
from agent.errors import ConfigError
from agent.runtime.telemetry.exporters import HttpExporter, TextfileExporter
from agent.runtime.telemetry.metrics import FIGURES, AgentCollector
from tests import peers
from tests.scenario.live import wait_until

STATUS: dict[str, Any] = {
    "version": "0.1.0", "uptime_s": 12.5,
    "rigs": [{
        "rig": "press", "lag_s": 0.25, "clock_offset_s": None, "clock_steps": 1, "alarm_states": {"UNACK": 2},
        "sources": [
            {"source": "can", "state": "ok", "received": 100, "used": 90, "rejected": {"crc": 7},
             "dropped": {"queue full": 3}, "gaps": 4},
            {"source": "late", "state": "lost"},
        ],
        "estimates": {"k1": {"value": 25.0, "sd": None, "unit": "N/m", "status": "valid"}},
    }],
    "stores": [{
        "db": "/x.db", "bytes": {"database": 4096, "log": 10}, "spare_bytes": 7, "failing": None,
        "written": 55,
        "dropped": {"disk full": 1}, "latency": {"press": {"bins": [("0.5", 3), ("+Inf", 4)], "sum_s": 2.5}},
    }],
    "north": [{
        "name": "plant", "kind": "mqtt", "db": "/x.db", "state": "failing", "error": "lost", "sent": 70,
        "retries": 4, "backfill": {"estimates": True}, "acknowledged": {"estimates": 1027, "alarms": 2},
        "lag": {"estimates": 5, "alarms": 0},
    }],
    "workers": [{"worker": 2, "alive": True, "restarts": 3}],
    "threads": [{"thread": "processing", "silent_s": 0.5, "stalled": True, "progress": 9}],
}  # fmt: skip


def status() -> dict[str, Any]:
    return STATUS


def values(text: str) -> dict[tuple[str, ...], float]:
    return {
        (sample.name, *sample.labels.values()): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


EXPECTED = {
    ("deltak_samples_received_total", "press", "can"): 100,
    ("deltak_samples_total", "used", "", "press", "can"): 90,
    ("deltak_samples_total", "rejected", "crc", "press", "can"): 7,
    ("deltak_samples_total", "dropped", "queue full", "press", "can"): 3,
    ("deltak_source_up", "press", "late"): 0,
    ("deltak_worker_up", "2"): 1,
    ("deltak_worker_restarts_total", "2"): 3,
    ("deltak_estimate_state", "k1", "press", "valid"): 1,
    ("deltak_estimate_state", "k1", "press", "invalid"): 0,
    ("deltak_alarms", "press", "UNACK"): 2,
    ("deltak_row_latency_seconds_bucket", "0.5", "press"): 3,
    ("deltak_row_latency_seconds_count", "press"): 4,
    ("deltak_store_bytes", "/x.db", "log"): 10,
    ("deltak_thread_stalled", "processing"): 1,
    ("deltak_clock_steps_total", "press"): 1,
    ("deltak_consumer_state", "/x.db", "plant", "failing"): 1,
    ("deltak_consumer_state", "/x.db", "plant", "ok"): 0,
    ("deltak_consumer_retries_total", "/x.db", "plant"): 4,
    ("deltak_consumer_rows_sent_total", "/x.db", "plant"): 70,
    ("deltak_consumer_acknowledged_seq", "/x.db", "plant", "estimates"): 1027,
    ("deltak_consumer_lag_rows", "/x.db", "plant", "estimates"): 5,
    ("deltak_consumer_backfill", "/x.db", "plant", "estimates"): 1,
}


def assert_expected(text: str) -> None:
    found = {tuple(sorted(key)): value for key, value in values(text).items()}
    assert {key: found.get(tuple(sorted(key))) for key in EXPECTED} == EXPECTED
    assert not any(
        name[0] == "deltak_clock_offset_seconds" for name in values(text)
    )  # not known yet: no figure


def test_metrics_are_served_over_http() -> None:
    exporter = HttpExporter("127.0.0.1:0", status)
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{exporter.port}/metrics", timeout=5.0) as answer:
            assert_expected(answer.read().decode())
    finally:
        exporter.stop()


def test_metrics_are_written_to_a_file_that_goes_with_the_agent(tmp_path: Path) -> None:
    file = tmp_path / "deltak.prom"
    exporter = TextfileExporter(file, status)
    try:
        wait_until(file.exists, "the file")
        assert_expected(file.read_text())
    finally:
        exporter.stop()
    assert not file.exists()


def test_metrics_file_is_written_through_no_symbolic_link(tmp_path: Path) -> None:
    file, others = tmp_path / "deltak.prom", tmp_path / "others"
    others.write_text("as it was")
    for name in (file.name, f"{file.name}.part"):
        (tmp_path / name).symlink_to(others)
    exporter = TextfileExporter(file, status)
    try:
        wait_until(lambda: not file.is_symlink() and file.exists(), "the file")
    finally:
        exporter.stop()
    assert others.read_text() == "as it was"


def exposed() -> set[str]:
    registry = CollectorRegistry(auto_describe=False)
    registry.register(AgentCollector(status))
    suffixes = {"histogram": ("_bucket", "_sum", "_count"), "counter": ("_total",), "gauge": ("",)}
    return {family.name + suffix for family in registry.collect() for suffix in suffixes[family.type]}


def test_names_follow_the_conventions_of_prometheus() -> None:
    for name in FIGURES:
        assert re.fullmatch(r"deltak(_[a-z]+)+", name), name
        assert not re.search(r"_(ms|minutes|kb|mb|percent)\b", name), name
    assert {name for name in FIGURES if "latency" not in name} <= exposed()


@pytest.mark.parametrize("name", ["grafana/deltak.json", "prometheus/deltak.rules.yml"])
def test_dashboard_and_rules_name_metrics_and_labels_that_exist(name: str) -> None:
    text = (peers.ROOT / "deploy" / name).read_text()
    used = set(re.findall(r"\bdeltak_[a-z_]+\b", text))
    assert len(used) >= 10
    assert used - exposed() == set()
    labels = {label for figure in FIGURES.values() for label in figure.labels}
    named = set(re.findall(r"\{\{ ?(?:\$labels\.)?([a-z]+) ?\}\}", text))
    assert named - labels <= {"instance"}


def test_rules_are_alerts_with_an_expression_and_words() -> None:
    (group,) = yaml.safe_load((peers.ROOT / "deploy/prometheus/deltak.rules.yml").read_text())["groups"]
    for rule in group["rules"]:
        assert rule["expr"].count("(") == rule["expr"].count(")")
        assert {"alert", "expr", "labels", "annotations"} <= set(rule)
        assert set(rule["annotations"]) == {"summary", "advice"}
    assert len({rule["alert"] for rule in group["rules"]}) == len(group["rules"]) > 8


def test_dashboard_shows_every_figure_of_the_agent() -> None:
    dashboard = json.loads((peers.ROOT / "deploy/grafana/deltak.json").read_text())
    text = json.dumps([target for panel in dashboard["panels"] for target in panel["targets"]])
    assert [name for name in FIGURES if name not in text] == []
    assert len({panel["id"] for panel in dashboard["panels"]}) == len(dashboard["panels"])


RIG = (peers.ROOT / "deploy/examples/modbus.toml").read_text()


@pytest.mark.parametrize(("keys", "words"), [
    ('listen = "0.0.0.0:9464"', "open to other machines, without a password; say unprotected = true"),
    ('listen = "9464"', 'must be "ADDRESS:PORT"'),
    ('textfile = "metrics.txt"', "must end in .prom"),
])  # fmt: skip
def test_metrics_table_refuses_what_nobody_meant(keys: str, words: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        parse(f"{RIG}\n[metrics]\n{keys}\n".encode(), peers.ROOT / "deploy/examples/x.toml")
    assert words in str(refusal.value)
    assert str(refusal.value).startswith("metrics.")


def test_metrics_table_takes_what_is_said() -> None:
    keys = 'listen = "0.0.0.0:9464"\nunprotected = true\ntextfile = "deltak.prom"'
    config = parse(f"{RIG}\n[metrics]\n{keys}\n".encode(), Path("/x/y.toml"))
    assert config.metrics == Metrics(unprotected=True, listen="0.0.0.0:9464", textfile=Path("/x/deltak.prom"))
