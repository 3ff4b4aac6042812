"""What must hold among channels, covariates and the names of columns."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from agent.config.draft import Draft
from agent.config.model.linear import LinearModel
from agent.config.model.tables import Channel, MechanicsModel
from agent.config.reading.domain_units import QUANTITIES
from agent.config.reading.fields import shown
from agent.config.reading.messages import join, listing, nearest
from agent.config.reading.parse import Entry, Faults, read_table, readable, unique
from agent.config.reading.units import conversion, examples, wrong_kind
from agent.config.sections.covariates import Covariate

ROLES: Final = ("signal", "covariate")
RESERVED: Final[Mapping[str, str]] = {
    "t": "recordings call their time column t",
    "delimiter": "[columns] has a key of that name",
}


def check_channels(draft: Draft) -> None:
    """Note the faults of channels."""
    _check_names(draft.channels, draft.faults)
    for entry in draft.channels:
        _check_unit(entry, draft.faults)
        if isinstance(draft.model, MechanicsModel):
            _check_place(entry, draft.model, draft.faults)
        elif isinstance(draft.model, LinearModel):
            _check_linear(entry, draft.faults)
    _check_same_units(draft.channels, draft.faults)
    complete = readable(*(entry.table.quantity for entry in draft.channels))
    if draft.channels and complete and not draft.outputs:
        draft.faults.add(
            "channel", "nothing is measured", "add a displacement, velocity or acceleration channel"
        )
    _check_columns(draft)


def _check_linear(entry: Entry[Channel], faults: Faults) -> None:
    path, channel = entry
    if channel.at:
        faults.add(f"{path}.at", "a linear model has no masses", "remove the key")
    if channel.quantity in QUANTITIES:
        what = f"{shown(channel.quantity)} is for the templates of other domains"
        faults.add(f"{path}.quantity", what, 'use "input" or "output"')


def _check_names(channels: list[Entry[Channel]], faults: Faults) -> None:
    unique(channels, faults)
    for path, channel in channels:
        if channel.name in RESERVED:
            faults.add(f"{path}.name", f"{shown(channel.name)} is reserved", RESERVED[channel.name])


def _check_unit(entry: Entry[Channel], faults: Faults) -> None:
    path, channel = entry
    if channel.scale == 0:
        faults.add(f"{path}.scale", "must not be 0", "it would make every sample the same")
    if not readable(channel.unit, channel.quantity):
        return
    kind = wrong_kind(channel.quantity, channel.unit)
    if kind:
        what = f"{shown(channel.unit)} is a unit of {kind}, not of {channel.quantity}"
        faults.add(f"{path}.unit", what, f"units of {channel.quantity} are {examples(channel.quantity)} ...")


def _check_place(entry: Entry[Channel], model: MechanicsModel, faults: Faults) -> None:
    path, channel = entry
    _check_quantity(entry, faults)
    if channel.at == "":
        faults.add(f"{path}.at", "is missing", 'name the mass it acts on or is measured at, such as "m1"')
    values = {mass.name: mass.value for mass in model.mass or ()}
    if not channel.at or not values or not readable(*values):
        return
    if channel.at not in values:
        faults.add(f"{path}.at", f"no mass is called {shown(channel.at)}", f"masses are {listing(values)}")
    elif channel.quantity == "acceleration" and values[channel.at] == 0:
        faults.add(
            f"{path}.at", f"{shown(channel.at)} has no mass, so no acceleration", "measure its displacement"
        )


def _check_quantity(entry: Entry[Channel], faults: Faults) -> None:
    path, channel = entry
    if channel.quantity in ("input", "output", *QUANTITIES):
        whose = "the templates of other domains" if channel.quantity in QUANTITIES else "linear models"
        wanted = "force, displacement, velocity or acceleration"
        faults.add(f"{path}.quantity", f"{shown(channel.quantity)} is for {whose}", f"use {wanted}")


def _check_same_units(channels: list[Entry[Channel]], faults: Faults) -> None:
    """Parameters have one unit each, so every channel of a mechanical quantity must be in the same one."""
    first: dict[str, tuple[str, str]] = {}
    for path, channel in channels:
        if not readable(channel.unit, channel.quantity) or channel.quantity in ("input", "output"):
            continue
        if wrong_kind(channel.quantity, channel.unit):
            continue
        unit = conversion(channel.quantity, channel.unit)[1]
        owner, before = first.setdefault(channel.quantity, (path, unit))
        if unit != before:
            what = f"{shown(channel.unit)} does not go with {shown(before)} of {owner}"
            faults.add(
                f"{path}.unit", what, f"give every {channel.quantity} the same unit, by scale and offset"
            )


def _check_columns(draft: Draft) -> None:
    owner: dict[str, str] = {}
    for key, column in (draft.columns.names or {}).items():
        if column in owner:
            what = f"{shown(column)} is the column of {owner[column]} already"
            draft.faults.add(join("columns", key), what, "give each channel a column of its own")
        owner.setdefault(column, key)
    known = ["t", *draft.channel_names, *draft.covariate_names]
    for key in draft.columns.names or {}:
        if key not in known and len(draft.channel_names) == len(draft.channels):
            advice = f'the nearest is "{nearest(key, known)}" of {listing(known)}'
            draft.faults.add(join("columns", key), f"no channel is called {shown(key)}", advice)


def split_channels(raw: object, faults: Faults) -> tuple[list[tuple[str, Any]], list[Entry[Covariate]]]:
    """Return the raw tables of the model's channels with their key paths, and the covariate channels."""
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
            faults.add(
                join(path, "role"), f"{shown(role)} is none of {listing(map(shown, ROLES))}", "choose one"
            )
        signals.append(
            (path, {k: v for k, v in row.items() if k != "role"} if isinstance(row, dict) else row)
        )
    return signals, covariates


def check_covariates(draft: Draft) -> None:
    """Note the faults of covariates and of [baseline]."""
    unique(draft.covariates, draft.faults, draft.channels)
    for path, one in draft.covariates:
        if one.scale == 0:
            draft.faults.add(join(path, "scale"), "must not be 0", "it would make every reading the same")
        if readable(one.range) and one.range is not None and not one.range[0] < one.range[1]:
            draft.faults.add(
                join(path, "range"), "must rise", "give the lowest value first, such as [-10.0, 40.0]"
            )
    _check_named(draft, draft.covariate_names)


def _check_named(draft: Draft, known: Sequence[str]) -> None:
    are_known = len(known) == len(draft.covariates)
    for name in draft.baseline.covariates or ():
        if name not in known and are_known:
            listed = f"covariates are {listing(known)}" if known else 'give a channel role = "covariate"'
            draft.faults.add("baseline.covariates", f"no covariate is called {shown(name)}", listed)
