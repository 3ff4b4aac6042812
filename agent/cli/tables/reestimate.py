"""`deltak reestimate`: archives estimated again, with progress, and tables of what was found."""

from collections.abc import Mapping
from typing import Any

from agent.cli.tables.results import print_results
from agent.cli.terminal.output import fault_document, print_faults, show
from agent.commissioning.progress import on_terminal
from agent.runtime.reestimation import reestimate as body

Document = Mapping[str, Any]


def reestimate(wanted: body.Wanted) -> dict[str, Any]:
    """Estimate archives again; what could not be used is said on stderr. Raises AgentError."""
    document = body.reestimate(wanted, on_terminal())
    print_faults(document["errors"])
    document["errors"] = [fault_document(fault) for fault in document["errors"]]
    return document


def print_reestimated(document: Document) -> None:
    """Print what was found of each rig, and how it was computed."""
    print_results(document)
    rigs = len(document["runs"])
    rate = document["samples_per_s"] or 0.0
    again = f", {document['repeated']} of them again" if document["repeated"] else ""
    where = f"{document['workers']} processes ({document['scheduler']})"
    show(
        f"{rigs} rig{'' if rigs == 1 else 's'} in {document['parts']} parts{again} on {where}: "
        f"{document['seconds']:.1f} s, {rate:,.0f} samples a second"
    )
