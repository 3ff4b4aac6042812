"""A trend and a forecast as sentences."""

from collections.abc import Mapping
from typing import Any

from agent.text import ahead, interval, number, percent, short_time, with_sd
from agent.units import DAY_S

Document = Mapping[str, Any]


def time_unit(seconds: float) -> tuple[int, str]:
    """Return seconds and name of the unit of time in which people read a span."""
    return (1, "second") if seconds < 600 else (3600, "hour") if seconds < 172_800 else (86_400, "day")


def unit_of(found: Document) -> str:
    """Return the unit as it is written behind a number; nothing for a bare number."""
    return "" if found["unit"] in {None, "1"} else str(found["unit"])


def verdict(found: Document) -> str:
    """Say in words whether the parameter changes, and how."""
    if found["slope_lower"] is None:
        return "too few rows to tell a drift"
    said = [_stepped(found, change) for change in found["changes"]]
    if found["trend"]:
        said.insert(0, _direction(found))
    return "; ".join(said) if said else "no trend"


def _direction(found: Document) -> str:
    newest, bend, sd = found["newest_slope_per_day"], found["curvature_per_day2"], found["curvature_sd"]
    slope = found["slope_per_day"] if newest is None else newest
    way = "falls" if slope < 0.0 else "rises"
    if bend is None or abs(bend) < 2.0 * sd:
        return way
    word = {"second": "second", "hour": "hour"}.get(time_unit(found["span_s"])[1], "month")
    return f"{way}, and {'faster' if (bend > 0.0) == (slope > 0.0) else 'slower'} each {word}"


def _stepped(found: Document, change: Document) -> str:
    before = found["value"] - change["size"]
    size = number(change["size"], 3) + f" {unit_of(found)}".rstrip()
    if before:
        size = f"{'−' if change['size'] / before < 0 else '+'}{percent(change['size'] / before)}"
    return f"stepped by {size} at {short_time(change['time'])}"


def drift(found: Document) -> str:
    """Write the drift in a unit of time that suits the span."""
    seconds, word = time_unit(found["span_s"])
    slope, sd, lower, upper = (
        found[f"slope_{k}"] * seconds / DAY_S for k in ("per_day", "sd", "lower", "upper")
    )
    change = f"{with_sd(slope, sd)} {unit_of(found)}".rstrip()
    return f"drift {change} per {word} (95 %: {interval(lower, upper)})"


def finding(found: Document) -> str:
    """Say whether there is a trend, beside the interval."""
    if found["trend"]:
        return f"a trend: {found['words']}"
    inside = found["slope_lower"] <= 0.0 <= found["slope_upper"]
    reason = "the interval holds 0" if inside else "a random walk or a season does as much"
    return f"no trend: {reason}" + (f"; {found['words']}" if found["changes"] else "")


def forecast_words(found: Document) -> str:
    """Say when the limit is reached, or why that cannot be said."""
    forecast = found["forecast"]
    status = forecast["status"]
    if status == "crossed":
        return "the limit is crossed already"
    chance = (
        ""
        if forecast["chance"] is None
        else f"; chance within {ahead(forecast['horizon_s'])} {_share(forecast)}"
    )
    if forecast["p50_s"] is not None:
        return f"reached in {_band(forecast)}{_likes(forecast)}{chance}"
    away = (
        found["slope_per_day"] is not None
        and found["slope_per_day"] * (found["limit"] - found["value"]) < 0.0
    )
    reasons = {
        "no trend": "no forecast: there is no trend",
        "too short": "no forecast: the history is too short to say",
        "beyond": "not reached in twenty times the history's span"
        + ("; it moves away from the limit" if away else ""),
    }
    return reasons[status] + chance


def record_words(forecast: Document) -> list[str]:
    """Say how good earlier forecasts of the parameter were; nothing where none was made."""
    record = forecast["record"]
    if record["made"]:
        crps = "" if record["crps"] is None else f"; CRPS {ahead(record['crps'])}"
        return [f"of {record['made']} made here, {record['held']} held within the 80 % band{crps}"]
    if record["waiting"]:
        return [f"{record['waiting']} made here wait for their time to be scored"]
    return []


def _likes(forecast: Document) -> str:
    like = forecast["like"]
    return "" if like is None else f" (with {like['histories']} like machines)"


def _band(forecast: Document) -> str:
    p10, p50, p90 = (forecast[f"{name}_s"] for name in ("p10", "p50", "p90"))
    return f"{ahead(p50)} (80 %: {ahead(p10)} … {ahead(p90)})"


def _share(forecast: Document) -> str:
    return f"{100.0 * forecast['chance']:.0f} %"
