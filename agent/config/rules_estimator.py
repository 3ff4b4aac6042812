"""What must hold in [estimator], [[alarm]] and [forecast]."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence

from agent.config.draft import Draft
from agent.config.model.tables import MechanicsModel
from agent.config.reading.fields import shown
from agent.config.reading.messages import listing, nearest
from agent.config.reading.parse import Faults, readable
from agent.config.tables import Alarm, Observer
from agent.config.tuning import COPIES, LEAST_EVERY_S, MOST_GB
from agent.text import counted


def check_estimator(draft: Draft) -> None:
    """Note the faults of the estimator."""
    _check_names(draft)
    _check_hold(draft)
    _check_observer(draft)
    _check_drift(draft)
    if draft.estimator.method == "seed":
        _check_seed(draft)
    else:
        _check_seed_only(draft)
    if draft.rate_hz is not None:
        _check_lengths(draft, draft.rate_hz)


def _check_names(draft: Draft) -> None:
    known, faults = draft.parameters, draft.faults
    if not known:
        return
    for i, name in enumerate(draft.estimator.estimate or ()):
        path = f"estimator.estimate[{i}]"
        if name in draft.estimator.estimate[:i]:
            faults.add(path, f"{shown(name)} is named twice", "name each parameter once")
        elif name not in known:
            advice = f'the nearest is "{nearest(name, known)}" of {listing(known)}'
            faults.add(path, f"no parameter is called {shown(name)}", advice)
        elif known[name].kind == "mass" and known[name].nominal == 0:
            faults.add(path, f"{shown(name)} is a massless node", "a mass of 0 cannot be estimated")
    if draft.estimator.estimate == () and not draft.defaults and isinstance(draft.model, MechanicsModel):
        faults.add(
            "estimator.estimate",
            "is missing: there is no spring and no damper",
            f"choose of {listing(known)}",
        )


def _check_seed(draft: Draft) -> None:
    """Note what the paper's method cannot do: it needs a fast observer, and an output to lean on."""
    estimator, faults = draft.estimator, draft.faults
    if readable(estimator.observer, estimator.observer.gain) and estimator.observer.gain != "poles":
        gain = shown(estimator.observer.gain)
        what = f'method = "seed" needs an observer given by its poles, not gain = {gain}'
        count = f"{draft.states} poles" if draft.states else "one pole a state"
        advice = f"give {count} two to six times as fast as the rig's own"
        faults.add("estimator.observer", what, f'{advice}: {{ gain = "poles", poles = [...] }}')
    _check_sensors(draft)


_OTHER_METHOD = 'method = "window-ml" does it'


def _check_seed_only(draft: Draft) -> None:
    """Note keys that only the paper's method has."""
    for key in ("stop", "rank"):
        if key in draft.estimator.model_fields_set:
            draft.faults.add(
                f"estimator.{key}", 'goes with method = "seed"', "remove it: there is no descent to end"
            )


def _check_sensors(draft: Draft) -> None:
    """Note sensor constants that the paper's method cannot estimate: offsets, and gains of all outputs."""
    names = draft.estimator.estimate or ()
    asked = [f"{path}.bias" for path, channel in draft.channels if channel.bias]
    asked += [f"estimator.estimate[{i}]" for i, name in enumerate(names) if _is_offset(draft, name)]
    for path in asked:
        what = 'method = "seed" estimates no offset of a sensor'
        draft.faults.add(path, what, f"remove it; {_OTHER_METHOD}")
    known = [
        entry for entry in draft.outputs if not (entry.table.gain or f"{entry.table.name}.gain" in names)
    ]
    if draft.outputs and not known:
        what = 'method = "seed" leans its observer on outputs whose gain is not estimated, and there is none'
        draft.faults.add("estimator.estimate", what, f"leave one gain out; {_OTHER_METHOD}")


def _is_offset(draft: Draft, name: str) -> bool:
    parameter = draft.parameters.get(name)
    return parameter is not None and parameter.kind == "bias"


def _check_drift(draft: Draft) -> None:
    """Note a longer window of straight lines: parameters are constant within a window."""
    if "drift_s" in draft.estimator.model_fields_set:
        advice = "remove it: parameters that move within seconds are followed without it"
        draft.faults.add("estimator.drift_s", "not in this version", advice)


def _check_hold(draft: Draft) -> None:
    hold, method = draft.estimator.hold, draft.estimator.method
    if method == "seed" and hold in ("cubic", "quintic"):
        what = f'{shown(hold)} goes with method = "window-ml": it takes readings that come after'
        draft.faults.add("estimator.hold", what, 'use "first" or "zero"')
    elif draft.is_discrete and "hold" in draft.estimator.model_fields_set and hold != "zero":
        what = (
            f"{shown(hold)} is for models in continuous time: "
            "one in discrete time was sampled with its own hold"
        )
        draft.faults.add("estimator.hold", what, "remove the key")


def _check_observer(draft: Draft) -> None:
    observer, faults, path = draft.estimator.observer, draft.faults, "estimator.observer"
    if not readable(observer.gain):
        return
    _check_belongs(path, "poles", "poles", observer, faults)
    _check_belongs(path, "process_sd", "kalman", observer, faults)
    _check_poles(f"{path}.poles", observer.poles or (), draft)
    masses = _pushed(draft.model) if isinstance(draft.model, MechanicsModel) else draft.states
    if draft.plant is not None:
        masses = len(draft.plant.pushed)
    given = len(observer.process_sd) if isinstance(observer.process_sd, tuple) else masses
    if masses and given != masses:
        faults.add(f"{path}.process_sd", f"has {given} numbers for {masses}", "give one a mass")


def _check_poles(path: str, poles: Sequence[float], draft: Draft) -> None:
    for i, pole in enumerate(poles):
        if pole >= 0:
            what = f"must be negative, not {shown(pole)}"
            draft.faults.add(f"{path}[{i}]", what, "poles are in 1/s, stable ones below 0")
    states = draft.states or len(poles)
    if poles and len(poles) != states:
        draft.faults.add(
            path, f"has {counted(len(poles), 'pole')} for {counted(states, 'state')}", "give one pole a state"
        )
    pole, times = max(Counter(poles).items(), key=lambda found: found[1], default=(0.0, 0))
    most = len(draft.outputs)
    if most and times > most:
        what = f"{pole:g} stands there {times} times; a pole can be placed once an output, {most} times here"
        draft.faults.add(path, what, "move the rest apart")


def _pushed(model: MechanicsModel) -> int:
    """How many nodes unknown forces are assumed on: those with mass, or all where none has."""
    values = [mass.value for mass in model.mass or () if readable(mass.value)]
    return sum(value > 0 for value in values) or len(values)


def _check_belongs(path: str, key: str, gain: str, observer: Observer, faults: Faults) -> None:
    there = key in observer.model_fields_set
    if observer.gain == gain and not there:
        faults.add(f"{path}.{key}", f'is missing: gain = "{gain}" needs it', "add it")
    elif observer.gain != gain and there:
        faults.add(
            f"{path}.{key}",
            f'goes with gain = "{gain}", not "{observer.gain}"',
            "remove it or change the gain",
        )


def _check_lengths(draft: Draft, rate_hz: float) -> None:
    estimator, faults = draft.estimator, draft.faults
    if readable(estimator.hop_s) and round(min(estimator.hop_s * rate_hz, 1e18)) < 1:
        advice = f"a sample takes {1 / rate_hz:g} s"
        faults.add("estimator.hop_s", f"{estimator.hop_s:g} s is less than a sample", advice)
    if not readable(estimator.window_s):
        return
    least = _least_samples(draft)
    for path, window_s in _windows(draft):
        samples = round(min(window_s * rate_hz, 1e18))
        if samples < least:
            what = f"{window_s:g} s is {counted(samples, 'sample')}"
            unknowns = (
                f"{counted(len(draft.estimated), 'parameter')} and {counted(draft.states or 0, 'state')}"
            )
            faults.add(path, what, f"{unknowns} need at least {least}: {least / rate_hz:g} s")
        elif samples > (most := _most_samples(draft)):
            needed = f"take about {samples / most * MOST_GB:.2g} GB of memory"
            what = f"{window_s:g} s is {samples:.3g} samples, which {needed}"
            faults.add(path, what, f"give {most / rate_hz:.3g} s at most, or sample more slowly")
    longest = max(estimator.windows_s, default=math.inf)
    if readable(estimator.hop_s) and estimator.hop_s > longest:
        what = f"{estimator.hop_s:g} s is longer than the window, {longest:g} s"
        faults.add("estimator.hop_s", what, "hop within the window, so that no sample is passed over")


def _windows(draft: Draft) -> Iterator[tuple[str, float]]:
    lengths = draft.estimator.window_s
    if isinstance(lengths, tuple):
        yield from ((f"estimator.window_s[{i}]", length) for i, length in enumerate(lengths))
    elif lengths != "auto":
        yield "estimator.window_s", lengths


def _least_samples(draft: Draft) -> int:
    """Samples of all outputs must outnumber the unknowns: parameters and the window's initial state."""
    unknowns = len(draft.estimated) + (draft.states or 0)
    return unknowns // max(len(draft.outputs), 1) + 2


def _most_samples(draft: Draft) -> int:
    return most_samples(len(draft.outputs), len(draft.estimated) + (draft.states or 0))


def most_samples(outputs: int, unknowns: int) -> int:
    """Return the longest window's samples: each linearised in every parameter and state for every output."""
    return round(MOST_GB * 1e9 / (8 * COPIES * max(outputs, 1) * (unknowns + outputs + 1)))


def check_alarms(draft: Draft) -> None:
    """Note the faults of alarms."""
    known = set[tuple[str, str]]()
    for path, alarm in draft.alarms:
        _check_kind(path, alarm, draft)
        _check_limit(path, alarm, draft)
        _check_within(path, alarm, draft)
        if not readable(alarm.parameter, alarm.kind):
            continue
        _check_parameter(path, alarm, draft)
        for kind in alarm.kinds or ("level",):
            if (alarm.parameter, kind) in known:
                what = f"{shown(alarm.parameter)} has a {kind} alarm already"
                draft.faults.add(f"{path}.parameter", what, "one a parameter and kind")
            known.add((alarm.parameter, kind))


_NEEDED = {"forecast": "within", "rate": "rate_per_day"}


def _check_kind(path: str, alarm: Alarm, draft: Draft) -> None:
    """Note a kind without what it is raised by."""
    key = _NEEDED.get(alarm.kind)
    if key is not None and key not in alarm.model_fields_set:
        example = {"within": '"30d"', "rate_per_day": "0.5"}[key]
        draft.faults.add(
            f"{path}.{key}", f'is missing: kind = "{alarm.kind}" needs it', f"write {key} = {example}"
        )


def _check_within(path: str, alarm: Alarm, draft: Draft) -> None:
    """Note a time within which nothing can be forecast."""
    given = [key for key in ("limit", "limit_percent") if key in alarm.model_fields_set]
    if alarm.within is not None and math.isinf(alarm.within):
        draft.faults.add(f"{path}.within", '"forever" is no time', 'write "30d"')
    if alarm.within is not None and not given:
        draft.faults.add(
            f"{path}.within", "goes with a limit that is to be reached", "give limit or limit_percent"
        )


def _check_parameter(path: str, alarm: Alarm, draft: Draft) -> None:
    known, estimated = draft.parameters, draft.estimated
    if not known or alarm.parameter in estimated:
        return
    if alarm.parameter in known:
        what = f"{shown(alarm.parameter)} is not estimated"
        draft.faults.add(
            f"{path}.parameter", what, f"add it to estimator.estimate; estimated are {listing(estimated)}"
        )
    else:
        what = f"no parameter is called {shown(alarm.parameter)}"
        draft.faults.add(f"{path}.parameter", what, f"estimated are {listing(estimated)}")


def _check_limit(path: str, alarm: Alarm, draft: Draft) -> None:
    given = [key for key in ("limit", "limit_percent") if key in alarm.model_fields_set]
    says_otherwise = not alarm.model_fields_set.isdisjoint({"rate_per_day", "within"})
    if says_otherwise and not given:
        return
    if len(given) != 1:
        what = "has both limit and limit_percent" if given else "has no limit"
        draft.faults.add(path, what, "give exactly one of limit and limit_percent")
        return
    parameter = draft.parameters.get(alarm.parameter)
    nominal_is_zero = parameter is not None and parameter.nominal == 0
    if alarm.limit_percent is not None and nominal_is_zero:
        what = f"a share of the nominal of {shown(alarm.parameter)}, which is 0"
        draft.faults.add(f"{path}.limit_percent", what, "give limit in the parameter's unit")
    _check_deadband(f"{path}.deadband", alarm, draft)


def _check_deadband(path: str, alarm: Alarm, draft: Draft) -> None:
    if alarm.limit is not None and alarm.deadband is not None and alarm.deadband >= alarm.limit:
        what = f"{alarm.deadband:g} leaves nothing of the limit {alarm.limit:g}: the alarm would never clear"
        draft.faults.add(path, what, "give less than the limit")


def check_forecast(draft: Draft) -> None:
    """Note the faults of [forecast] that its values do not show by themselves."""
    asked = draft.forecast
    if readable(asked.every) and asked.every < LEAST_EVERY_S:
        what = (
            f"{asked.every:g} s is too often: "
            "a forecast takes a tenth of a second, and more on a small gateway"
        )
        draft.faults.add("forecast.every", what, 'give "10s" or more')
    if asked.horizon is not None and math.isinf(asked.horizon):
        draft.faults.add("forecast.horizon", '"forever" is no horizon', 'write "90d", or leave it out')
    for i, path in enumerate(asked.like or ()):
        if not (draft.folder / path).exists():
            what = f"there is no file {shown(str(draft.folder / path))}"
            advice = "name databases, tables, or a prior by deltak fleet learn"
            draft.faults.add(f"forecast.like[{i}]", what, advice)
