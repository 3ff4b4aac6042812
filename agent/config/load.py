"""From a file to a checked configuration, with every fault at once."""

import hashlib
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, cast

from agent.config.domains.kinds import DOMAINS
from agent.config.domains.plant import Domain
from agent.config.draft import Draft
from agent.config.model.linear import LinearModel
from agent.config.model.linear_files import with_matrices
from agent.config.model.tables import Channel, MechanicsModel
from agent.config.reading.fields import shown
from agent.config.reading.messages import join, listing, nearest
from agent.config.reading.parse import Entry, Faults, read_list, read_table
from agent.config.reading.secrets import without_plain_secrets
from agent.config.reading.toml_file import parse_toml, read_bytes
from agent.config.rules_channels import check_channels, check_covariates, split_channels
from agent.config.rules_constants import check_constants
from agent.config.rules_estimator import check_alarms, check_estimator, check_forecast
from agent.config.rules_model import check_model
from agent.config.rules_north import check_north
from agent.config.rules_sources import check_notify, check_sources, divided, read_sources
from agent.config.sections.covariates import BaselineTable
from agent.config.sections.north import North
from agent.config.sections.process import Agent, agreed
from agent.config.sections.results import Forecast, Metrics, Notify, Store
from agent.config.tables import Alarm, Columns, Estimator, Rig, RigConfig
from agent.errors import ConfigError, Fault

TABLES: Final = (
    "rig", "model", "channel", "estimator", "alarm", "source", "store", "columns", "forecast", "baseline",
    "metrics", "notify", "north", "agent",
)  # fmt: skip
RESERVED: Final = ("http", "mqtt", "security", "serve")
LATER: Final[Mapping[tuple[str, str], tuple[str, ...]]] = {
    ("estimator", "method"): ("ekf", "ukf", "rls"),
    ("alarm", "kind"): ("sensor", "source", "mismatch"),
}
_KINDS: Final[Mapping[str, type[MechanicsModel] | type[LinearModel] | type[Domain]]] = {
    "mass-spring-damper": MechanicsModel,
    "linear": LinearModel,
    **DOMAINS,
}
_RULES: Final = (
    check_model, check_channels, check_constants, check_estimator, check_alarms, check_sources,
    check_forecast, check_notify, check_north, check_covariates,
)  # fmt: skip
_DELIMITERS: Final = {"comma": ",", "semicolon": ";", "tab": "\t", ",": ",", ";": ";", "\t": "\t"}


def load(path: str | Path, *, identified: bool = False) -> RigConfig:
    """Read and check one configuration file; identified: nominals are yet to be found, none need be stated.

    Relative paths in it start at its folder. Raises ConfigError with every fault of the file; each names its
    key path, or file and line where the file is not TOML.
    """
    file = Path(os.path.abspath(path))  # noqa: PTH100 - resolve() would follow links and change the folder
    data = read_bytes(file)
    return parse(data, file, identified=identified)


def parse(data: bytes, file: Path, *, identified: bool = False) -> RigConfig:
    """Check a configuration's bytes as if they stood in `file`; raises ConfigError with every fault."""
    raw = parse_toml(data, file)
    draft = Draft(file.parent, identified)
    _read(raw, draft)
    for check in _RULES:
        check(draft)
    if draft.faults.found:
        raise ConfigError(_ordered(draft.faults.found))
    content = data + "".join(draft.attached).encode("ascii")
    return _finished(draft, file, hashlib.sha256(content).hexdigest())


def load_many(paths: Iterable[str | Path]) -> tuple[RigConfig, ...]:
    """Read the configurations of one agent: rigs differ in name, and those of one store agree on [store].

    Raises ConfigError with every fault of every file, each path led by its file where there are several.
    """
    files, configs, faults = [Path(path) for path in paths], [], []
    for file in files:
        try:
            configs.append(load(file))
        except ConfigError as error:
            faults += [_led(fault, file, many=len(files) > 1) for fault in error.faults]
    faults += _conflicts(configs)
    if faults:
        raise ConfigError(faults)
    return tuple(configs)


def _led(fault: Fault, file: Path, *, many: bool) -> Fault:
    if not many or str(file) in fault.path:
        return fault
    return Fault(f"{file}: {fault.path}", fault.message, fault.advice)


def _conflicts(configs: list[RigConfig]) -> list[Fault]:
    rigs: dict[str, Path] = {}
    stores: dict[Path, RigConfig] = {}
    faults = []
    for config in configs:
        owner = rigs.setdefault(config.rig.name, config.file)
        if owner is not config.file:
            what = f"{shown(config.rig.name)} is the rig of {owner} too"
            faults.append(Fault(f"{config.file}: rig.name", what, "rigs of one agent must differ"))
        first = stores.setdefault(config.store.path, config)
        for key in ("every_s", "commit_s", "keep", "max_mb"):
            if getattr(config.store, key) != getattr(first.store, key):
                what = f"differs from that of {first.file}, which shares the store"
                faults.append(Fault(f"{config.file}: store.{key}", what, "make them the same"))
        faults += _other_targets(config, first)
    return faults + agreed([(config.file, config.agent) for config in configs])[1]


def _other_targets(config: RigConfig, first: RigConfig) -> list[Fault]:
    """Return a fault for each target and consumer that differs in a configuration that shares the store."""
    faults = []
    for table, what in (("notify", "target"), ("north", "consumer")):
        known = {one.name: one for one in getattr(first, table)}
        words = f"is another {what} in {first.file}, which shares the store"
        faults += [
            Fault(f"{config.file}: {table}[{i}].name", f"{shown(one.name)} {words}", "name them differently")
            for i, one in enumerate(getattr(config, table))
            if known.get(one.name, one) != one
        ]
    return faults


def _read(raw: Mapping[str, Any], draft: Draft) -> None:
    faults = draft.faults
    _check_names(raw, faults)
    raw = _without_later(cast("dict[str, Any]", without_plain_secrets(raw, "", faults)), draft)
    for key, table in (("rig", "[rig]"), ("model", "[model]"), ("channel", "[[channel]]")):
        if key not in raw:
            faults.add(key, "is missing", f"add {table}")
    if "rig" in raw:
        draft.rig = read_table(Rig, raw["rig"], "rig", faults)
    if "model" in raw:
        _read_model(raw["model"], draft)
    _read_channels(raw.get("channel", []), draft)
    draft.estimator = read_table(Estimator, raw.get("estimator", {}), "estimator", faults)
    draft.alarms = read_list(Alarm, raw.get("alarm", []), "alarm", faults)
    draft.sources = read_sources(raw.get("source", []), faults)
    draft.store = read_table(Store, raw.get("store", {}), "store", faults)
    _read_columns(raw.get("columns", {}), draft)
    draft.forecast = read_table(Forecast, raw.get("forecast", {}), "forecast", faults)
    draft.baseline = read_table(BaselineTable, raw.get("baseline", {}), "baseline", faults)
    draft.metrics = read_table(Metrics, raw.get("metrics", {}), "metrics", faults)
    draft.notify = read_list(Notify, raw.get("notify", []), "notify", faults)
    draft.north = read_list(North, raw.get("north", []), "north", faults)
    draft.agent = read_table(Agent, raw.get("agent", {}), "agent", faults)


def _read_channels(raw: object, draft: Draft) -> None:
    if not isinstance(raw, list):
        read_list(Channel, raw, "channel", draft.faults)
        return
    signals, draft.covariates = split_channels(raw, draft.faults)
    draft.channels = [Entry(path, read_table(Channel, row, path, draft.faults)) for path, row in signals]


def _check_names(raw: Mapping[str, Any], faults: Faults) -> None:
    """Note the tables that do not exist, or not in this version."""
    for key in raw:
        if key in RESERVED:
            faults.add(key, "is not in this version", "remove the table")
        elif key not in TABLES:
            known = f'the nearest known one is "{nearest(key, TABLES)}" of {listing(TABLES)}'
            faults.add(join("", key), "unknown table", known)


def _without_later(raw: Mapping[str, Any], draft: Draft) -> dict[str, Any]:
    """Complain of values of a later version and take them out, so that nothing else complains of them."""
    kept = dict(raw)
    for (table, key), values in LATER.items():
        rows = kept.get(table)
        if isinstance(rows, dict):
            kept[table] = _cleared(rows, key, values, table, draft)
        elif isinstance(rows, list):
            kept[table] = [_cleared(row, key, values, join(table, i), draft) for i, row in enumerate(rows)]
    return kept


def _cleared(row: Any, key: str, values: tuple[str, ...], path: str, draft: Draft) -> Any:
    if not isinstance(row, dict) or row.get(key) not in values:
        return row
    draft.faults.add(f"{path}.{key}", f"{shown(row[key])} is not in this version", "leave the key out")
    return {k: v for k, v in row.items() if k != key}


def _read_model(raw: object, draft: Draft) -> None:
    mechanical = "mass-spring-damper"
    if not isinstance(raw, dict):
        draft.faults.add("model", f"must be a table, not {shown(raw)}", "write [model]")
        return
    kind = raw.get("kind", mechanical)
    is_known = isinstance(kind, str) and kind in _KINDS
    if not is_known:
        draft.faults.add(
            "model.kind", f"{shown(kind)} is none of {listing(map(shown, _KINDS))}", "choose one"
        )
        kind = "linear" if "A" in raw else mechanical
        raw = {**raw, "kind": kind}
    if kind == "linear":
        raw, draft.attached = with_matrices(raw, draft.folder, draft.faults)
    read: Any = read_table(_KINDS[kind], raw, "model", draft.faults)
    draft.model = read


def _read_columns(raw: object, draft: Draft) -> None:
    if not isinstance(raw, dict):
        draft.faults.add("columns", f"must be a table, not {shown(raw)}")
        return
    delimiter = raw.get("delimiter")
    if delimiter is not None and not (isinstance(delimiter, str) and delimiter in _DELIMITERS):
        draft.faults.add("columns.delimiter", f"{shown(delimiter)} is none", "comma, semicolon and tab are")
        delimiter = None
    names = {key: value for key, value in raw.items() if key != "delimiter"}
    for key, value in names.items():
        if not isinstance(value, str) or not value:
            draft.faults.add(join("columns", key), f"must be a column's name in quotes, not {shown(value)}")
    named = {key: value for key, value in names.items() if isinstance(value, str)}
    draft.columns = Columns.model_construct(names=named, delimiter=delimiter and _DELIMITERS[delimiter])


def _ordered(faults: list[Fault]) -> list[Fault]:
    """Sort by the file's tables; the order within a table is the order of finding."""
    rank = {name: number for number, name in enumerate(TABLES)}
    return sorted(
        dict.fromkeys(faults), key=lambda fault: rank.get(fault.path.split(".")[0].split("[")[0], -1)
    )


def _finished(draft: Draft, file: Path, sha256: str) -> RigConfig:
    if draft.rig is None or draft.model is None:
        raise AssertionError("a draft without faults has a rig and a model")
    sources = [divided(entry.table, draft.covariate_names) for entry in draft.sources]
    path = draft.store.path if draft.store.path != Path() else Path(f"{draft.rig.name}.db")
    return RigConfig(
        rig=draft.rig,
        model=draft.model,
        channel=tuple(entry.table for entry in draft.channels),
        estimator=draft.estimator.model_copy(update={"estimate": draft.estimated, "hold": draft.hold}),
        alarm=tuple(_with_defaults(entry.table, draft) for entry in draft.alarms),
        source=tuple(source for source in sources if source.map or not source.covariates),
        covariate=tuple(entry.table for entry in draft.covariates),
        covariate_source=tuple(source for source in sources if source.covariates and not source.map),
        baseline=draft.baseline,
        store=draft.store.model_copy(update={"path": _store_path(draft.folder / path)}),
        columns=draft.columns,
        forecast=draft.forecast.beside(draft.folder),
        metrics=_placed(draft.metrics, draft.folder),
        notify=tuple(entry.table for entry in draft.notify),
        north=tuple(entry.table for entry in draft.north),
        agent=draft.agent,
        file=file,
        sha256=sha256,
    )


def _placed(metrics: Metrics, folder: Path) -> Metrics:
    """Return the table with its path from the root on."""
    file = metrics.textfile
    return metrics if file is None else metrics.model_copy(update={"textfile": folder / file})


def _store_path(path: Path) -> Path:
    """Return the one name of a database, however its folder is written: one file has one writer."""
    return Path(os.path.realpath(path.parent)) / path.name


def _with_defaults(alarm: Alarm, draft: Draft) -> Alarm:
    update: dict[str, float] = {}
    if alarm.deadband is None and alarm.limit is not None:
        update["deadband"] = 0.1 * alarm.limit
    windows = draft.estimator.windows_s
    if alarm.on_delay_s is None and len(windows) == 1:
        update["on_delay_s"] = windows[0]
    return alarm.model_copy(update=update)
