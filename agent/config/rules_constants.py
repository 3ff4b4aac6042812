"""What must hold in what data sheets leave open: of masses, gains, delays and the sensors' noise."""

from agent.config.draft import Draft
from agent.config.model.tables import Channel, Mass, MechanicsModel
from agent.config.reading.fields import Table, shown
from agent.config.reading.parse import Entry, Faults, readable
from agent.config.tuning import MOST_PERCENT, MOST_SPREAD


def check_constants(draft: Draft) -> None:
    """Note the faults of sd_percent, gain_sd_percent, delay_sd_s and noise_sd_spread."""
    estimated = set(draft.estimated)
    if isinstance(draft.model, MechanicsModel):
        for i, mass in enumerate(draft.model.mass or ()):
            _check_mass(Entry(f"model.mass[{i}]", mass), estimated, draft.faults)
    for entry in draft.channels:
        _check_gain(entry, estimated, draft.faults)
        _check_delay(entry, draft)
        _check_spread(entry, draft.faults)


def _check_mass(entry: Entry[Mass], estimated: set[str], faults: Faults) -> None:
    path, mass = entry
    if not _stated(mass, "sd_percent"):
        return
    if mass.value == 0:
        faults.add(f"{path}.sd_percent", f"{shown(mass.name)} is a massless node", "remove the key")
    elif mass.name in estimated:
        what = f"{shown(mass.name)} is estimated, which takes it for unknown"
        faults.add(f"{path}.sd_percent", what, "remove the key, or the mass from estimator.estimate")
    _check_percent(f"{path}.sd_percent", mass.sd_percent, faults)


def _check_gain(entry: Entry[Channel], estimated: set[str], faults: Faults) -> None:
    path, channel = entry
    if not _stated(channel, "gain_sd_percent"):
        return
    if channel.gain or f"{channel.name}.gain" in estimated:
        what = f"the gain of {shown(channel.name)} is estimated, which takes it for unknown"
        faults.add(f"{path}.gain_sd_percent", what, "remove the key, or let the gain not be estimated")
    _check_percent(f"{path}.gain_sd_percent", channel.gain_sd_percent, faults)


def _check_delay(entry: Entry[Channel], draft: Draft) -> None:
    path, channel = entry
    if not (_stated(channel, "delay_sd_s") and readable(channel.quantity) and channel.delay_sd_s):
        return
    if channel.is_input:
        return
    measured = [e for e in draft.channels if readable(e.table.quantity) and not e.table.is_input]
    if len(measured) < 2:
        what = "goes with a force or an input, against which the only reading of the motion may be late"
        draft.faults.add(f"{path}.delay_sd_s", what, "state it there")
    elif draft.estimator.hold != "first":
        what = f'of what is measured it goes with hold = "first", not {shown(draft.estimator.hold)}'
        draft.faults.add(f"{path}.delay_sd_s", what, "remove the key, or calibrate the channel's delay_s")


def _check_spread(entry: Entry[Channel], faults: Faults) -> None:
    path, channel = entry
    if not _stated(channel, "noise_sd_spread"):
        return
    if "noise_sd" not in channel.model_fields_set:
        what = "there is no noise_sd that it could be of"
        faults.add(f"{path}.noise_sd_spread", what, "give noise_sd, or remove the key: the noise is learnt")
    if channel.noise_sd_spread > MOST_SPREAD:
        what = f"must be at most {MOST_SPREAD:g}, not {channel.noise_sd_spread:g}"
        advice = "it is a share: 0.3 is 30 %; leave noise_sd out where nothing is known"
        faults.add(f"{path}.noise_sd_spread", what, advice)


def _check_percent(path: str, percent: float, faults: Faults) -> None:
    if percent > MOST_PERCENT:
        what = f"must be at most {MOST_PERCENT:g} %, not {percent:g}"
        faults.add(path, what, "estimate what is known no better, by estimator.estimate")


def _stated(table: Table, key: str) -> bool:
    """Tell whether a key stands in the file and could be read."""
    return key in table.model_fields_set and readable(getattr(table, key))
