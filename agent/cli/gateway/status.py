"""`deltak status` and `deltak reload`: what a running agent says of itself, its configuration reloaded."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from agent.cli.gateway.agent_of import asked, database_of
from agent.cli.terminal.output import print_table, show
from agent.cli.tuning import RELOAD_WAIT_S
from agent.errors import ConfigError, Fault

Document = Mapping[str, Any]


def status(named: Path | None) -> Document:
    """Return the document of `deltak status`. Raises StoreError where no agent runs."""
    return asked(database_of(named), "status")


def reload(named: Path | None) -> Document:
    """Have the agent take up its changed files; raises ConfigError with all faults where it refuses them."""
    found = asked(database_of(named), "reload", timeout_s=RELOAD_WAIT_S)
    if "refused" in found:
        raise ConfigError(Fault(**fault) for fault in found["refused"])
    return found


def print_status(found: Document) -> None:
    """Print an agent's state as tables."""
    rows = [_rig_row(rig) for rig in found["rigs"]]
    title = f"deltak {found['version']}, running for {found['uptime_s']:.0f} s"
    print_table(title, ("rig", "lag", "sources", "alarms", "estimates"), rows, right=("lag", "alarms"))
    stores = [
        (s["db"], f"{sum(s['bytes'].values()) / 1e6:.1f}", s["failing"] or "written") for s in found["stores"]
    ]
    print_table("", ("database", "MB", "state"), stores, right=("MB",))
    stalled = [thread["thread"] for thread in found["threads"] if thread["stalled"]]
    if stalled:
        show(f"no progress: {', '.join(stalled)}")


def _rig_row(rig: Document) -> tuple[str, ...]:
    lag = "" if rig["lag_s"] is None else f"{rig['lag_s']:.1f} s"
    sources = ", ".join(f"{source['source']} {source['state']}" for source in rig["sources"])
    estimates = ", ".join(f"{name} {row['status']}" for name, row in rig["estimates"].items())
    return rig["rig"], lag, sources, str(rig["alarms"]), estimates


def print_reload(found: Document) -> None:
    """Print which rigs a reload touched."""
    show("; ".join(f"{what}: {', '.join(rigs)}" for what, rigs in found.items() if rigs))
