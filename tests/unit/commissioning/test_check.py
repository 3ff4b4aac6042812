"""`deltak check`: its document, its warnings, and what it predicts held against what the estimator then
delivers."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.commissioning.check import check
from agent.errors import RecordingError
from agent.runtime.replay import replay
from tests.scenario.live import EXAMPLES, example, rows
from tests.scenario.offline import play

KEYS = {"ok", "errors", "warnings", "observable", "poles", "observer", "condition_3", "condition_8",
        "predicted_sd", "bytes_per_rig_year"}  # fmt: skip


def checked(config: Path, recording: Path | None = None) -> dict[str, Any]:
    return check(config=config, recording=recording, probe=False)


def edited(folder: Path, *changes: tuple[str, str]) -> Path:
    path = example("modbus", folder)
    text = path.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


def warned(document: Mapping[str, Any], path: str) -> list[str]:
    return [w["message"] for w in document["warnings"] if w["path"].startswith(path)]


def predicted(document: Mapping[str, Any]) -> dict[tuple[float, str], float]:
    """What windows are to scatter by: the constants as they are."""
    return {(row["window_s"], row["parameter"]): row["sd_repeat"] for row in document["predicted_sd"]}


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_check_every_example_is_usable_and_its_document_complete(path: Path) -> None:
    document = checked(path)
    assert document.keys() >= KEYS
    assert (document["ok"], document["errors"], document["observable"]) == (True, [], True)
    assert all(
        0 < row["sd_repeat"] <= row["sd"] < np.inf and row["assumes"] for row in document["predicted_sd"]
    )
    assert 1e6 < document["bytes_per_rig_year"] < 1e9


def test_check_springs_side_by_side_names_what_would_tell_them_apart(tmp_path: Path) -> None:
    spring = '{ name = "k1", between = ["ground", "m1"], nominal = 25.0 }'
    beside = '{ name = "k3", between = ["m1", "ground"], nominal = 9.0 }'
    (fault,) = checked(edited(tmp_path, (spring, f"{spring}, {beside}")))["errors"]
    assert fault["message"].startswith('"k1" and "k3" cannot be told apart')
    assert fault["advice"].startswith("measure the force that one of them carries")
    assert fault["advice"].endswith("or leave one of them out of the estimate")


def test_check_poles_and_conditions_are_those_of_the_model(tmp_path: Path) -> None:
    document = checked(edited(tmp_path))
    M, K, B = (
        np.diag([5.0, 3.0]),
        np.array([[125.0, -100.0], [-100.0, 100.0]]),
        np.array([[10.0, -5.0], [-5.0, 5.0]]),
    )
    inverse = np.linalg.inv(M)
    A = np.block([[-inverse @ B, -inverse @ K], [np.eye(2), np.zeros((2, 2))]])
    ours = [complex(pole["re"], pole["im"]) for pole in document["poles"]]
    for pole in np.linalg.eigvals(A):
        assert min(abs(pole - found) for found in ours) < 1e-9
    slowest = document["poles"][0]
    assert slowest["freq_hz"] == pytest.approx(abs(ours[0]) / (2 * np.pi))
    assert slowest["damping_ratio"] == pytest.approx(-ours[0].real / abs(ours[0]))
    radius = max(abs(np.exp(1e-3 * np.linalg.eigvals(A))))
    assert document["condition_3"] == {
        "holds": True,
        "radius_model": pytest.approx(radius, abs=1e-12),
        "radius_observer": pytest.approx(radius, abs=1e-12),
    }
    eighth = document["condition_8"]
    assert eighth["h_infinity"] == pytest.approx(1 / eighth["delta"])
    assert eighth["holds"] is False


def test_check_placed_poles_are_where_they_were_asked_for(tmp_path: Path) -> None:
    poles = [-45.0, -40.0, -35.0, -30.0]
    gain = f'hop_s = 0.05\nobserver = {{ gain = "poles", poles = {poles} }}'
    document = checked(edited(tmp_path, ("hop_s = 0.05", gain)))
    found = sorted(z["re"] for z in document["observer"]["poles_z"])
    assert found == pytest.approx(sorted(np.exp(np.array(poles) * 1e-3)), abs=1e-9)
    assert np.array(document["observer"]["gain"]).shape == (4, 2)


def test_check_predicted_sd_is_what_windows_then_deliver(tmp_path: Path) -> None:
    """Played with 5 N rms instead of the 1 N that is assumed: a fifth of the sd, by the median over windows.

    These are a rig's first windows, which do not exclude unknown forces yet.
    """
    reported = predicted(checked(edited(tmp_path)))
    calm = '[[force]]\nkind = "random"\nrms = 5.0\n[noise]\ndisplacement = 1e-6\n'
    (tmp_path / "calm.toml").write_text(calm, encoding="utf-8")
    seen: dict[str, list[float]] = {}
    for seed in range(4):
        played = play(str(tmp_path / "calm.toml"), tmp_path, seed)
        for index in range(1249, 3000, 250):
            for name, sd in played.repeat(index).items():
                seen.setdefault(name, []).append(sd)
    for name, sds in seen.items():
        assert 0.5 < reported[0.25, name] / 5.0 / np.median(sds) < 1.6, name


def test_check_longer_windows_tell_more_and_more_force_tells_in_proportion(tmp_path: Path) -> None:
    reported = predicted(checked(edited(tmp_path, ("window_s = 0.25", "window_s = [0.25, 1.0, 4.0]"))))
    for name in ("k1", "k2", "B1", "B2"):
        assert reported[0.25, name] > 1.5 * reported[1.0, name] > 2 * reported[4.0, name]


def test_check_without_known_noise_assumes_the_wire_and_says_so(tmp_path: Path) -> None:
    document = checked(edited(tmp_path, ("noise_sd = 1e-6", "# noise_sd = 1e-6")))
    assert "no more than the wire's resolution" in document["predicted_sd"][0]["assumes"]
    assert len(warned(document, "channel[1]")) == 1


def test_check_without_a_force_assumes_free_decay(tmp_path: Path) -> None:
    force = "[[channel]]                        # the force"
    path = edited(tmp_path)
    text = path.read_text(encoding="utf-8")
    start = text.index(force)
    text = text[:start] + text[text.index("[[channel]]", start + 5) :]
    text = text.replace('{ force = "force", x1', "{ x1")
    path.write_text(text, encoding="utf-8")
    document = checked(path)
    assert document["ok"]
    assert document["predicted_sd"][0]["assumes"].startswith("free decay from 0.01 m")


def test_check_warns_of_a_window_shorter_than_a_period(tmp_path: Path) -> None:
    assert (
        "shorter than a period of the slowest mode, 3.67 s"
        in warned(checked(edited(tmp_path)), "estimator")[0]
    )
    longer = checked(edited(tmp_path, ("window_s = 0.25", "window_s = 4.0")))
    assert warned(longer, "estimator") == []


def test_check_warns_of_a_bound_that_the_newest_hour_of_rows_exceeds(tmp_path: Path) -> None:
    assert warned(checked(edited(tmp_path, ("every_s = 0", "every_s = 1.0\nmax_mb = 1"))), "store") == []
    document = checked(edited(tmp_path, ("every_s = 0", "every_s = 0\nmax_mb = 0.3")))
    assert "17 MB, and it always stays" in warned(document, "store")[0]
    assert document["bytes_per_rig_year"] > 16e6


def test_check_weighs_every_window_of_auto_and_warns_of_what_none_of_them_tells(tmp_path: Path) -> None:
    document = checked(edited(tmp_path, ("window_s = 0.25", 'window_s = "auto"')))
    lengths = sorted({row["window_s"] for row in document["predicted_sd"]})
    assert len(lengths) == 5
    assert lengths[-1] > 3.67 * 3
    assert warned(document, "estimator") == []
    strict = checked(edited(tmp_path, ("window_s = 0.25", 'window_s = "auto"\nresolve = 1e-6')))
    said = warned(strict, "estimator")
    assert [message.split(" tell ")[1].split()[0] for message in said] == ["k1", "k2", "B1", "B2"]
    assert all(message.startswith(f"{lengths[-1]:g} s tell") for message in said)


def test_check_warns_of_a_mass_that_nothing_holds(tmp_path: Path) -> None:
    text = example("modbus", tmp_path).read_text(encoding="utf-8")
    for name in ("k1", "B1"):
        text = re.sub(rf'{{ name = "{name}", between = [^}}]*}}, ', "", text)
    text = text[: text.index("[[alarm]]")] + text[text.index("[[source]]") :]
    path = tmp_path / "free.toml"
    path.write_text(text, encoding="utf-8")
    document = checked(path)
    assert document["ok"]
    assert "does not decay" in warned(document, "model")[0]
    assert not document["condition_3"]["holds"]
    assert document["condition_3"]["radius_observer"] < 1 - 1e-6


def test_check_warns_of_a_short_on_delay_and_a_slow_rate(tmp_path: Path) -> None:
    changes = (("limit = 15.0", "on_delay_s = 0.05\nlimit = 15.0"),
               ("sample_rate_hz = 1000.0", "sample_rate_hz = 5.0"),
               ("window_s = 0.25", "window_s = 4.0"), ("hop_s = 0.05", "hop_s = 1.0"))  # fmt: skip
    document = checked(edited(tmp_path, *changes))
    assert len(warned(document, "alarm[0].on_delay_s")) == 1
    (slow,) = [w for w in document["warnings"] if w["path"] == "rig.sample_rate_hz"]
    assert "few samples a period" in slow["message"]
    assert 'hold = "quintic"' in slow["advice"]


def test_check_warns_under_twenty_samples_a_period_and_not_above(tmp_path: Path) -> None:
    """The fastest mode is at 1.13 Hz."""
    window = ("window_s = 0.25", "window_s = 4.0"), ("hop_s = 0.05", "hop_s = 1.0")
    few, enough = (
        checked(edited(tmp_path, ("sample_rate_hz = 1000.0", f"sample_rate_hz = {rate}"), *window))
        for rate in ("20.0", "30.0")
    )
    (slow,) = [w for w in few["warnings"] if w["path"] == "rig.sample_rate_hz"]
    assert 'hold = "cubic"' in slow["advice"]
    assert warned(enough, "rig.sample_rate_hz") == []


def test_check_faulty_model_still_tells_poles_and_every_fault(tmp_path: Path) -> None:
    spring = "nominal = 25.0 }"
    more = f'{spring}, {{ name = "k3", between = ["m1", "ground"], nominal = 9.0 }}'
    document = checked(edited(tmp_path, (spring, more)))
    assert document["ok"] is False
    assert [error["path"] for error in document["errors"]] == ["estimator.estimate"]
    assert len(document["poles"]) == 4
    assert document["predicted_sd"] == []


def recording(folder: Path, *, gap: bool = False, samples: int = 3000) -> Path:
    rng = np.random.default_rng(5)
    path = folder / "measured.csv"
    lines = ["t,force,x1,x2"]
    for k in range(samples):
        if not (gap and 1000 <= k < 1010):
            x1, x2 = 1e-3 * np.sin(2e-3 * k), 2e-3 * np.cos(3e-3 * k)
            noise = 1e-6 * rng.standard_normal(2)
            lines.append(
                f"{k / 1000:.3f},{rng.standard_normal():.6f},{x1 + noise[0]:.9f},{x2 + noise[1]:.9f}"
            )
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_check_recording_tells_rate_range_and_noise_of_each_channel(tmp_path: Path) -> None:
    facts = checked(edited(tmp_path), recording(tmp_path))["recording"]
    assert (facts["used"], facts["gaps"], facts["span_s"]) == (3000, 0, pytest.approx(2.999))
    channels = {channel["name"]: channel for channel in facts["channels"]}
    assert channels["x1"]["rate_hz"] == pytest.approx(1000.0)
    assert channels["x1"]["noise_sd"] == pytest.approx(1e-6, rel=0.1)
    assert channels["x2"]["max"] == pytest.approx(2e-3, rel=0.01)
    assert channels["force"]["noise_sd"] is None


def test_check_recording_is_the_excitation_and_its_gaps_are_warned_of(tmp_path: Path) -> None:
    path = recording(tmp_path, gap=True)
    document = checked(edited(tmp_path), path)
    assert document["predicted_sd"][0]["assumes"].startswith("the excitation of measured.csv")
    assert warned(document, "")[-1] == "measured.csv has 1 gap, 10 samples missing"
    assert all(np.isfinite(list(predicted(document).values())))


def test_check_recording_shorter_than_a_window_predicts_nothing_and_says_so(tmp_path: Path) -> None:
    document = checked(edited(tmp_path, ("window_s = 0.25", "window_s = 10.0")), recording(tmp_path))
    assert all(np.isnan(sd) for sd in predicted(document).values())
    assert any("no uninterrupted 10 s" in message for message in warned(document, "estimator.window_s"))


def test_check_empty_recording_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "none.csv"
    path.write_text("t,force,x1,x2\n,,,\n", encoding="utf-8")
    with pytest.raises(RecordingError):
        checked(edited(tmp_path), path)


def test_replay_of_a_rig_without_alarms_or_sources_works_as_check_promised(tmp_path: Path) -> None:
    text = edited(tmp_path).read_text(encoding="utf-8")
    path = tmp_path / "plain.toml"
    path.write_text(text[: text.index("[[alarm]]")], encoding="utf-8")
    document = checked(path)
    assert document["ok"]
    assert warned(document, "source") == ["there is none"]
    replay(config=path, recordings=[recording(tmp_path, samples=400)], db=tmp_path / "plain.db")
    assert rows(tmp_path / "plain.db", "SELECT count(*) FROM v_estimates") == [(4 * 8,)]


def test_check_model_that_grows_beyond_all_measure_is_warned_of_without_a_word_of_numpy(
    tmp_path: Path,
) -> None:
    text = (EXAMPLES / "coupled_tanks.toml").read_text(encoding="utf-8")
    stable = re.search(r"(?m)^A = .*$", text)
    assert stable is not None
    path = tmp_path / "unstable.toml"
    path.write_text(text.replace(stable.group(), "A = [[0.08, 0.08], [0.05, 0.075]]"), encoding="utf-8")
    document = checked(path)
    assert any("unstable" in message for message in warned(document, "model"))
    assert all(np.isnan(row["sd"]) and "grows" in row["assumes"] for row in document["predicted_sd"])


@pytest.mark.parametrize(("clock", "misses"), [("counter", "no counter"), ("device", "no time stamps")])
def test_check_warns_of_a_clock_that_the_source_does_not_have(
    tmp_path: Path, clock: str, misses: str
) -> None:
    text = example("serial", tmp_path).read_text(encoding="utf-8")
    (counter,) = re.findall(r"(?m)^counter = .*$", text)
    path = tmp_path / "clock.toml"
    text = re.sub(r"(?m)^clock = .*$", f'clock = "{clock}"', text)
    path.write_text(text.replace(counter, ""), encoding="utf-8")
    assert any(misses in message for message in warned(checked(path), "source[0]"))
    path.write_text(
        re.sub(r"(?m)^clock = .*$", 'clock = "arrival"', text).replace(counter, ""), encoding="utf-8"
    )
    assert not warned(checked(path), "source[0]")
