"""The agent's figures by the conventions of Prometheus, made of the status document at each scrape.

prometheus_client (extra `metrics`) is imported only where a configuration asks for metrics.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from prometheus_client.metrics_core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    Metric,
)

from agent.types import Status

Document = Mapping[str, Any]


class Figure(NamedTuple):
    """One metric: what makes it, its help and its labels."""

    family: Callable[..., Any]
    help: str
    labels: Sequence[str] = ()


FIGURES: Mapping[str, Figure] = {
    "deltak_build_info": Figure(GaugeMetricFamily, "The version that runs.", ("version",)),
    "deltak_uptime_seconds": Figure(GaugeMetricFamily, "Time since the agent started."),
    "deltak_rig_lag_seconds": Figure(GaugeMetricFamily, "Age of the newest sample.", ("rig",)),
    "deltak_source_up": Figure(GaugeMetricFamily, "1 while a source delivers samples.", ("rig", "source")),
    "deltak_samples_received_total": Figure(
        CounterMetricFamily, "Sample instants received in this run.", ("rig", "source")
    ),
    "deltak_samples_total": Figure(
        CounterMetricFamily, "Sample instants by what became of them.", ("rig", "source", "fate", "reason")
    ),
    "deltak_sample_gaps_total": Figure(CounterMetricFamily, "Gaps in a source's samples.", ("rig", "source")),
    "deltak_row_latency_seconds": Figure(
        HistogramMetricFamily, "From the newest sample of a commit to its row on the disk.", ("rig",)
    ),
    "deltak_estimate_value": Figure(GaugeMetricFamily, "Newest estimate, SI.", ("rig", "parameter", "unit")),
    "deltak_estimate_sd": Figure(GaugeMetricFamily, "Its standard deviation.", ("rig", "parameter", "unit")),
    "deltak_estimate_state": Figure(
        GaugeMetricFamily, "1 for the state of the newest estimate.", ("rig", "parameter", "state")
    ),
    "deltak_alarms": Figure(GaugeMetricFamily, "Alarms whose condition stands, by state.", ("rig", "state")),
    "deltak_clock_offset_seconds": Figure(
        GaugeMetricFamily, "Newest time stamp against the gateway's clock.", ("rig",)
    ),
    "deltak_clock_steps_total": Figure(CounterMetricFamily, "Steps of the gateway's clock.", ("rig",)),
    "deltak_store_bytes": Figure(
        GaugeMetricFamily, "Size of a database and what lies beside it.", ("db", "part")
    ),
    "deltak_store_spare_bytes": Figure(GaugeMetricFamily, "Free space on its disk.", ("db",)),
    "deltak_store_failing": Figure(GaugeMetricFamily, "1 while it cannot be written.", ("db",)),
    "deltak_store_rows_written_total": Figure(CounterMetricFamily, "Rows acknowledged.", ("db",)),
    "deltak_store_rows_dropped_total": Figure(
        CounterMetricFamily, "Rows that could not be stored.", ("db", "reason")
    ),
    "deltak_consumer_state": Figure(
        GaugeMetricFamily, "1 for the state of a consumer beyond the gateway.", ("db", "consumer", "state")
    ),
    "deltak_consumer_retries_total": Figure(
        CounterMetricFamily, "Attempts to supply it that failed.", ("db", "consumer")
    ),
    "deltak_consumer_rows_sent_total": Figure(
        CounterMetricFamily, "Rows that it acknowledged, those sent again too.", ("db", "consumer")
    ),
    "deltak_consumer_acknowledged_seq": Figure(
        GaugeMetricFamily, "Number up to which it has every row.", ("db", "consumer", "topic")
    ),
    "deltak_consumer_lag_rows": Figure(
        GaugeMetricFamily, "Stored rows that it lacks; of estimates, instants.", ("db", "consumer", "topic")
    ),
    "deltak_consumer_backfill": Figure(
        GaugeMetricFamily, "1 while it lacks rows that are older than some it has.",
        ("db", "consumer", "topic"),
    ),
    "deltak_worker_up": Figure(GaugeMetricFamily, "1 while a worker process runs.", ("worker",)),
    "deltak_worker_restarts_total": Figure(
        CounterMetricFamily, "How often a worker process had to be started anew.", ("worker",)
    ),
    "deltak_thread_silent_seconds": Figure(
        GaugeMetricFamily, "For how long a thread made no progress.", ("thread",)
    ),
    "deltak_thread_stalled": Figure(
        GaugeMetricFamily, "1 where the watchdog is not fed because of it.", ("thread",)
    ),
    "deltak_thread_progress_total": Figure(
        CounterMetricFamily, "How often a thread went round.", ("thread",)
    ),
}  # fmt: skip
_STATES = tuple(status.name.lower() for status in Status)
_CONSUMER_STATES = ("ok", "connecting", "failing")
_BY_TOPIC = {
    "acknowledged": "deltak_consumer_acknowledged_seq",
    "lag": "deltak_consumer_lag_rows",
    "backfill": "deltak_consumer_backfill",
}
"""Metrics of a consumer by topic, by their keys in the status document."""
_ALARM_STATES = ("UNACK", "ACKED", "SHLVD", "DSUPR", "OOSRV")


class AgentCollector:
    """Gives a registry of prometheus_client the agent's figures; `document` makes the status document."""

    def __init__(self, document: Callable[[], Document]) -> None:
        self._document = document

    def collect(self) -> Iterable[Metric]:
        """Return every metric."""
        return _Families().filled(self._document())


class _Families:
    """The metrics of one scrape while they are filled."""

    def __init__(self) -> None:
        self._made = {
            name: figure.family(name.removesuffix("_total"), figure.help, labels=figure.labels)
            for name, figure in FIGURES.items()
        }

    def filled(self, document: Document) -> list[Metric]:
        self._add("deltak_build_info", 1, document["version"])
        self._add("deltak_uptime_seconds", document["uptime_s"])
        for rig in document["rigs"]:
            self._rig(rig)
        for store in document["stores"]:
            self._store(store)
        for consumer in document["north"]:
            self._consumer(consumer)
        for worker in document["workers"]:
            self._add("deltak_worker_up", worker["alive"], worker["worker"])
            self._add("deltak_worker_restarts_total", worker["restarts"], worker["worker"])
        for thread in document["threads"]:
            self._add("deltak_thread_silent_seconds", thread["silent_s"], thread["thread"])
            self._add("deltak_thread_stalled", thread["stalled"], thread["thread"])
            self._add("deltak_thread_progress_total", thread["progress"], thread["thread"])
        return list(self._made.values())

    def _add(self, name: str, value: float | None, *labels: str) -> None:
        if value is not None:
            self._made[name].add_metric([str(label) for label in labels], float(value))

    def _rig(self, rig: Document) -> None:
        name = rig["rig"]
        self._add("deltak_rig_lag_seconds", rig["lag_s"], name)
        self._add("deltak_clock_offset_seconds", rig["clock_offset_s"], name)
        self._add("deltak_clock_steps_total", rig["clock_steps"], name)
        for state in _ALARM_STATES:
            self._add("deltak_alarms", rig["alarm_states"].get(state, 0), name, state)
        for source in rig["sources"]:
            self._source(name, source)
        for parameter, row in rig["estimates"].items():
            self._add("deltak_estimate_value", row["value"], name, parameter, row["unit"])
            self._add("deltak_estimate_sd", row["sd"], name, parameter, row["unit"])
            for state in _STATES:
                self._add("deltak_estimate_state", row["status"] == state, name, parameter, state)

    def _source(self, rig: str, source: Document) -> None:
        name = source["source"]
        self._add("deltak_source_up", source["state"] == "ok", rig, name)
        if "received" not in source:
            return
        self._add("deltak_samples_received_total", source["received"], rig, name)
        self._add("deltak_samples_total", source["used"], rig, name, "used", "")
        for fate in ("rejected", "dropped"):
            for reason, count in source[fate].items():
                self._add("deltak_samples_total", count, rig, name, fate, reason)
        self._add("deltak_sample_gaps_total", source["gaps"], rig, name)

    def _store(self, store: Document) -> None:
        db = store["db"]
        for part, size in store["bytes"].items():
            self._add("deltak_store_bytes", size, db, part)
        self._add("deltak_store_spare_bytes", store["spare_bytes"], db)
        self._add("deltak_store_failing", store["failing"] is not None, db)
        self._add("deltak_store_rows_written_total", store["written"], db)
        for reason, count in store["dropped"].items():
            self._add("deltak_store_rows_dropped_total", count, db, reason)
        for rig, found in store["latency"].items():
            self._made["deltak_row_latency_seconds"].add_metric([rig], found["bins"], found["sum_s"])

    def _consumer(self, consumer: Document) -> None:
        own = (consumer["db"], consumer["name"])
        for state in _CONSUMER_STATES:
            self._add("deltak_consumer_state", consumer["state"] == state, *own, state)
        self._add("deltak_consumer_retries_total", consumer["retries"], *own)
        self._add("deltak_consumer_rows_sent_total", consumer["sent"], *own)
        for key, name in _BY_TOPIC.items():
            for topic, value in consumer[key].items():
                self._add(name, value, *own, topic)
