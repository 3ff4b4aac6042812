"""What `deltak check` says to people, from its document."""

from collections import defaultdict
from collections.abc import Mapping
from typing import Any

from agent.cli.terminal.output import fault_of, print_table, show
from agent.text import counted, number

Document = Mapping[str, Any]


def print_check(document: Document) -> None:
    """Print observability, poles, conditions, expected sds, warnings; what the document lacks is left out."""
    given = defaultdict(list[Any], {key: value for key, value in document.items() if value is not None})
    if given["ok"]:
        identified = "observable" in given
        show(
            "the configuration is usable"
            if identified
            else "the configuration is usable once it is identified"
        )
    for warning in given["warnings"]:
        show(f"warning: {warning if isinstance(warning, str) else fault_of(warning)}")
    if "observable" in given:
        show(f"states are {'' if given['observable'] else 'not '}observable from the channels")
    _print_poles(given["poles"])
    _print_conditions(document)
    _print_region(document.get("region"))
    _print_box(document.get("box_margin"))
    _print_paper(document.get("paper_conditions"), document.get("recentring"))
    _print_recording(document.get("recording"), "the recording")
    _print_recording(document.get("probe"), "the probe")
    _print_predicted(given["predicted_sd"])
    if given["bytes_per_rig_year"]:
        show(f"the database grows by about {document['bytes_per_rig_year'] / 1e6:.0f} MB a year")


def _print_poles(poles: list[Document]) -> None:
    if not poles:
        return
    columns = ("pole", "frequency, Hz", "damping ratio")
    rows = (
        (
            f"{pole['re']:.6g} {pole['im']:+.6g}j",
            number(pole.get("freq_hz"), 4),
            number(pole.get("damping_ratio"), 4),
        )
        for pole in poles
    )
    print_table("poles of the nominal model", columns, rows, right=columns)


def _print_conditions(document: Document) -> None:
    third, eighth = document.get("condition_3"), document.get("condition_8")
    if third:
        radii = f"model {number(third.get('radius_model'))}, observer {number(third.get('radius_observer'))}"
        show(f"condition (3) {_holds(third)}: spectral radius of the {radii}")
    if eighth:
        sizes = (
            f"perturbation {number(eighth.get('perturbation_norm'))}, margin {number(eighth.get('delta'))}"
        )
        show(f"condition (8) {_holds(eighth)}: {sizes}")


_OVER = {
    "radius_model": "spectral radius of the model",
    "radius_observer": "spectral radius of the observer",
    "observability": "least share of a motion that the channels show",
}


def _print_region(region: Document | None) -> None:
    """Print the worst value of each measure within the alarm limits, and where it is."""
    for key, words in _OVER.items() if region else ():
        worst = region[key] if region else {}
        place = ", ".join(f"{name} = {number(value)}" for name, value in worst["at"].items())
        figures = f"{number(worst['nominal'])} at nominal, at worst {number(worst['value'])}"
        show(f"within the alarm limits, {words}: {figures} ({place})")


def _print_paper(found: Document | None, passes: Document | None) -> None:
    if found:
        exists, ranks, special = found["condition_11"], found["condition_12"], found["condition_15"]
        left = (
            f"{100 * exists['defect_states']:.3g} % of (10) for the states, "
            f"{100 * exists['defect_outputs']:.3g} %"
        )
        show(
            f"condition (11) over the last {found['window_s']:g} s: "
            f"no one matrix explains {left} for the outputs"
        )
        show(
            f"condition (12): rank {ranks['rank']} of the states, "
            f"{ranks['rank_joined']} with what they are to explain"
        )
        one = f"for one sample alone Z = 0 leaves {100 * special['defect_of_one_sample']:.3g} %"
        over = (
            "Z = 0 would do here"
            if special["z_zero"]
            else "the states fill too few directions, so Z is needed"
        )
        show(f"condition (15) over the window: {over}; {one}")
    if passes:
        reach = "reach" if passes["converges"] else "do not reach"
        show(
            f"re-centred passes {reach} the right parameters: "
            f"each step is {number(passes['ratio'])} of the last"
        )


def _print_box(box: Document | None) -> None:
    if not box:
        return
    reach = ", ".join(f"{name} ± {number(value, 3)}" for name, value in box["reach"].items())
    share = f"{number(100 * box['share'], 3)} % of the limits"
    proven = f"stable however the parameters move within {reach} ({share})"
    show(proven if box["share"] > 0 else "no range in which parameters may move at will is proven stable")


def _print_recording(facts: Document | None, what: str) -> None:
    if not facts:
        return
    columns = (
        "channel",
        "unit",
        "samples a second",
        "least",
        "most",
        "noise sd",
        "missing",
        "gaps",
        "clock, ppm",
    )
    rows = (_channel(c) for c in facts["channels"])
    if facts["channels"]:
        samples, gaps = counted(facts["used"], "sample"), counted(facts["gaps"], "gap")
        ledger = f"{samples} in {number(facts['span_s'], 4)} s, {gaps}"
        print_table(f"{what}: {ledger}", columns, rows, right=columns[2:])
    for source in facts["sources"]:
        if source.get("skew_s") is not None:
            skew = f"{1e3 * source['skew_s']:.3f} ± {1e3 * source['skew_sd_s']:.3f} ms"
            show(f"{source['name']}: read {skew} later than the reference source; compensated")
    if facts["channels"] and not facts["suspicions"]:
        show("no channel is suspected of being swapped, turned round or mis-scaled")


def _channel(channel: Document) -> tuple[str, ...]:
    drift, sd = channel["drift_ppm"], channel["drift_sd_ppm"]
    clock = "" if drift is None else f"{drift:+.1f} ± {2 * sd:.1f}"
    figures = (number(channel[key], 4) for key in ("rate_hz", "min", "max", "noise_sd"))
    return (channel["name"], channel["unit"], *figures, str(channel["missing"]), str(channel["gaps"]), clock)


def _holds(condition: Document) -> str:
    return "holds" if condition.get("holds") else "does not hold"


def _print_predicted(rows: list[Document]) -> None:
    """Print what the windows can tell; what that rests on stands in each row only where rows differ."""
    if not rows:
        return
    columns: tuple[str, ...] = ("parameter", "window, s", "sd to expect", "unit", "with")
    cells = [_predicted(row) for row in rows]
    bases = {basis for *_, basis in cells}
    alike = len(bases) == 1
    if alike:
        columns, cells = columns[:-1], [cell[:-1] for cell in cells]
    print_table("what the windows can tell", columns, cells, right=columns[1:3])
    if alike:
        show(f"with {bases.pop()}")


def _predicted(row: Document) -> tuple[str, ...]:
    figures = (number(row.get("window_s")), number(row.get("sd"), 3))
    return (str(row["parameter"]), *figures, str(row.get("unit") or ""), str(row.get("assumes") or ""))
