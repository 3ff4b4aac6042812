"""What must hold of covariates: names, ranges, and that [baseline] names those there are."""

from collections.abc import Sequence
from typing import Any

from agent.config.covariates.tables import Covariate
from agent.config.draft import Draft
from agent.config.reading.fields import shown
from agent.config.reading.messages import join, listing
from agent.config.reading.parse import Entry, Faults, read_table, readable

ROLES = ("signal", "covariate")


def parted(raw: object, faults: Faults) -> tuple[list[tuple[str, Any]], list[Entry[Covariate]]]:
    """Return the raw tables of the model's channels with their key paths, and the channels that are covariates."""
    rows = raw if isinstance(raw, list) else []
    signals: list[tuple[str, Any]] = []
    covariates: list[Entry[Covariate]] = []
    for i, row in enumerate(rows):
        path = join("channel", i)
        role = row.get("role", "signal") if isinstance(row, dict) else "signal"
        if role == "covariate":
            covariates.append(Entry(path, read_table(Covariate, row, path, faults)))
            continue
        if role not in ROLES:
            faults.add(join(path, "role"), f"{shown(role)} is none of {listing(map(shown, ROLES))}", "choose one")
        signals.append((path, {k: v for k, v in row.items() if k != "role"} if isinstance(row, dict) else row))
    return signals, covariates


def check_covariates(draft: Draft) -> None:
    """Note the faults of covariates and of [baseline]."""
    owner = {entry.table.name: entry.path for entry in draft.channels if readable(entry.table.name)}
    for path, one in draft.covariates:
        if one.name in owner:
            what = f"{shown(one.name)} is the name of {owner[one.name]}"
            draft.faults.add(join(path, "name"), what, "names must differ")
        elif readable(one.name):
            owner[one.name] = path
        if one.scale == 0:
            draft.faults.add(join(path, "scale"), "must not be 0", "it would make every reading the same")
        if readable(one.range) and one.range is not None and not one.range[0] < one.range[1]:
            draft.faults.add(join(path, "range"), "must rise", "give the lowest value first, such as [-10.0, 40.0]")
    _check_named(draft, [one.name for _, one in draft.covariates])


def _check_named(draft: Draft, known: Sequence[str]) -> None:
    for name in draft.baseline.covariates or ():
        if name not in known:
            listed = f"covariates are {listing(known)}" if known else 'give a channel role = "covariate"'
            draft.faults.add("baseline.covariates", f"no covariate is called {shown(name)}", listed)
