"""What a right file means: values, defaults, units, names that are filled in, paths."""

import math
from functools import cache
from pathlib import Path

import pytest

from agent.config import LinearModel, MechanicsModel, driver_class, plugins
from agent.config.reading.units import conversion, wrong_kind
from agent.errors import ConfigError
from tests.unit.config.config_driver import FakeDriver, FakeSettings
from tests.unit.config.config_texts import MINIMAL, MOTOR, PRESS, changed, faults, read, with_fake_driver


@pytest.fixture(autouse=True)
def _fake_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    with_fake_driver(monkeypatch)


def test_config_of_the_contract_reads_as_written() -> None:
    config = read(PRESS)
    assert (config.rig.name, config.rig.site, config.rig.sample_rate_hz) == ("press-7", "hall 2", 1000.0)
    assert isinstance(config.model, MechanicsModel)
    assert [mass.value for mass in config.model.mass] == [5.0, 3.0]
    assert config.model.spring[1].between == ("m1", "m2")
    assert [channel.name for channel in config.inputs] == ["force"]
    assert [channel.name for channel in config.outputs] == ["x1", "x2"]
    assert config.channel[1].noise_sd == 1e-6
    assert config.estimator.estimate == ("k1", "k2", "B1", "B2")
    alarm = config.alarm[0]
    assert (alarm.limit, alarm.deadband, alarm.on_delay_s, alarm.off_delay_s) == (15.0, 1.5, 0.2, 2.0)
    assert (config.store.keep.full, config.store.keep.hour) == (7 * 86400.0, math.inf)
    assert config.store.path == Path("/rigs/press-7.db")


def test_config_with_little_written_has_the_defaults_of_the_contract() -> None:
    config = read(changed(MINIMAL, ("[[channel]]", '[[alarm]]\nparameter = "k"\nlimit = 50\n[[channel]]')))
    assert config.rig.clock == "counter"
    assert config.estimator.model_dump() == {
        "method": "window-ml", "window_s": 0.25, "hop_s": 0.05, "hold": "first", "estimate": ("k", "b"),
        "observer": {"gain": "auto", "poles": (), "process_sd": None}, "resolve": 0.33, "passes": 10,
        "drift_s": None,
        "stop": {"step": 1e-12, "cost": 0.0, "iterations": 20000}, "rank": None,
    }  # fmt: skip
    alarm = config.alarm[0]
    assert (alarm.side, alarm.confidence, alarm.priority) == ("both", 0.95, "medium")
    assert (alarm.deadband, alarm.on_delay_s, alarm.off_delay_s) == (5.0, 0.25, 0.0)
    channel = config.channel[0]
    assert (channel.scale, channel.offset, channel.noise_sd, channel.delay_s) == (1.0, 0.0, None, 0.0)
    assert (channel.noise_sd_spread, channel.gain_sd_percent, channel.delay_sd_s) == (0.3, 1.0, None)
    assert isinstance(config.model, MechanicsModel)
    assert config.model.mass[0].sd_percent == 2.0
    assert not channel.bias
    assert not channel.gain
    assert (config.store.path, config.store.every_s, config.store.max_mb) == (
        Path("/rigs/bench.db"),
        1.0,
        1024,
    )
    assert config.store.keep.model_dump() == {"full": 604800.0, "minute": 7776000.0, "hour": math.inf}
    assert config.source == ()


def test_alarm_defaults_of_a_share_or_of_several_windows_are_left_to_the_alarm() -> None:
    share = changed(PRESS, ("limit = 15.0", "limit_percent = 10"), ("deadband = 1.5\non_delay_s = 0.2", ""))
    alarm = read(changed(share, ("window_s = 0.25", "window_s = [1.0, 0.25]"))).alarm[0]
    assert (alarm.limit, alarm.limit_percent, alarm.deadband, alarm.on_delay_s) == (None, 10, None, None)


@pytest.mark.parametrize(
    ("text", "lengths"), [("0.25", (0.25,)), ("2", (2.0,)), ("[1, 0.5]", (0.5, 1.0)), ('"auto"', ())]
)
def test_window_forms_give_lengths_in_order(text: str, lengths: tuple[float, ...]) -> None:
    assert read(changed(PRESS, ("window_s = 0.25", f"window_s = {text}"))).estimator.windows_s == lengths


def test_observer_forms_are_read() -> None:
    poles = read(changed(PRESS, ('gain = "auto"', 'gain = "poles", poles = [-45, -40, -35, -30]')))
    assert poles.estimator.observer.poles == (-45.0, -40.0, -35.0, -30.0)
    one = read(changed(PRESS, ('gain = "auto"', 'gain = "kalman", process_sd = 0.5')))
    each = read(changed(PRESS, ('gain = "auto"', 'gain = "kalman", process_sd = [0.5, 0]')))
    assert (one.estimator.observer.process_sd, each.estimator.observer.process_sd) == (0.5, (0.5, 0.0))


def test_parameters_of_a_rig_in_volts_and_counts_carry_these_units() -> None:
    config = read(changed(PRESS, ('unit = "N"', 'unit = "V"'), ('unit = "m"', 'unit = "counts"'),
                          ('unit = "m"', 'unit = "counts"')))  # fmt: skip
    units = {name: parameter.unit for name, parameter in config.parameters.items()}
    assert (units["k1"], units["B1"], units["m1"]) == ("V/counts", "V s/counts", "V s2/counts")
    assert (units["x1.bias"], units["force.gain"]) == ("counts", "1")


def test_parameters_of_an_si_rig_have_kinds_nominals_and_si_units() -> None:
    parameters = read(changed(PRESS, ('unit = "N"', 'unit = "kN"'), ('unit = "m"', 'unit = "mm"'))).parameters
    assert [p.unit for p in parameters.values()][:6] == ["kg", "kg", "N/m", "N/m", "N s/m", "N s/m"]
    assert (parameters["k2"].kind, parameters["k2"].nominal) == ("spring", 100.0)
    assert (parameters["x1.bias"].unit, parameters["x1.gain"].nominal) == ("m", 1.0)


@pytest.mark.parametrize(
    ("quantity", "unit", "expected"),
    [
        ("force", "kN", (1e3, "N")), ("force", "mN", (1e-3, "N")), ("force", "V", (1.0, "V")),
        ("displacement", "um", (1e-6, "m")), ("displacement", "µm", (1e-6, "m")),
        ("displacement", "μm", (1e-6, "m")),
        ("displacement", "counts", (1.0, "counts")), ("displacement", "in", (0.0254, "m")),
        ("velocity", "mm/s", (1e-3, "m/s")), ("acceleration", "g", (9.80665, "m/s2")),
        ("acceleration", "m/s²", (1.0, "m/s2")), ("acceleration", "m/s^2", (1.0, "m/s2")),
        ("input", "N", (1.0, "N")), ("output", "degC", (1.0, "degC")),
    ],
)  # fmt: skip
def test_unit_becomes_si_or_is_kept(quantity: str, unit: str, expected: tuple[float, str]) -> None:
    factor, si = conversion(quantity, unit)  # type: ignore[arg-type]
    assert (factor, si) == (pytest.approx(expected[0]), expected[1])


@pytest.mark.parametrize(
    ("quantity", "unit", "kind"),
    [
        ("displacement", "kg", "mass"), ("force", "m", "displacement"), ("velocity", "m", "displacement"),
        ("acceleration", "mm/s", "velocity"), ("displacement", "N/m", "stiffness"),
        ("force", "Hz", "frequency"),
        ("force", "V", None), ("displacement", "counts", None), ("acceleration", "g", None),
        ("output", "kg", None),
    ],
)  # fmt: skip
def test_unit_of_another_kind_is_told_from_unknown_text(quantity: str, unit: str, kind: str | None) -> None:
    assert wrong_kind(quantity, unit) == kind  # type: ignore[arg-type]


def test_linear_model_reads_with_its_parameters_estimated_by_default() -> None:
    config = read(MOTOR)
    assert isinstance(config.model, LinearModel)
    assert config.model.A == ((-2.0, -50.0), (5.0, -0.1))
    assert config.estimator.estimate == ("R",)
    assert (config.parameters["R"].nominal, config.parameters["R"].unit) == (2.0, "ohm")
    assert (config.channel[1].si_unit, config.channel[1].si_factor) == ("A", 1.0)


def test_source_has_its_drivers_settings_and_takes_its_name() -> None:
    second = (
        '[[source]]\ndriver = "can"\ninterface = "socketcan"\ndbc = "b.dbc"\nmap = { x2 = "B.x" }\n[store]'
    )
    config = read(changed(PRESS, (', x2 = "RIG_SAMPLE.X2" }', " }"), ("[store]", second)))
    first = config.source[0]
    assert isinstance(first.settings, FakeSettings)
    assert (first.settings.interface, first.settings.dbc) == ("socketcan", "press7.dbc")
    assert first.map == {"force": "RIG_SAMPLE.Force", "x1": "RIG_SAMPLE.X1"}
    assert (first.counter, first.stale_s, first.record) == ("RIG_SAMPLE.Counter", 2.0, False)
    assert [source.name for source in config.source] == ["can", "can-2"]


def test_source_with_the_same_own_keys_shares_a_connection() -> None:
    first, other = read(PRESS), read(changed(PRESS, ('channel = "can0"', 'channel = "can1"')))
    again = read(changed(PRESS, ("counter = ", "stale_s = 9.0\ncounter = ")))
    assert first.source[0].connection(first.folder) == again.source[0].connection(again.folder)
    assert first.source[0].connection(first.folder) != other.source[0].connection(other.folder)


def test_columns_name_channels_time_and_delimiter() -> None:
    text = changed(
        PRESS, ("[store]", '[columns]\nx1 = "Encoder 1 Pos"\nt = "Time"\ndelimiter = "tab"\n[store]')
    )
    columns = read(text).columns
    assert (columns.names, columns.delimiter) == ({"x1": "Encoder 1 Pos", "t": "Time"}, "\t")


def test_store_path_that_is_absolute_stays() -> None:
    text = changed(PRESS, ('path = "press-7.db"', 'path = "/var/lib/deltak/x.db"'))
    assert read(text).store.path == Path("/var/lib/deltak/x.db")


def test_secret_by_file_or_environment_is_no_plain_secret() -> None:
    reference = changed(PRESS, ("[store]", '[store]\npassword = { env = "DELTAK_PASSWORD" }'))
    assert faults(reference).keys() == {"store.password"}
    assert "unknown key" in faults(reference)["store.password"]
    assert "must not stand" not in faults(reference)["store.password"]


def test_massless_node_held_through_a_chain_of_dampers_is_taken() -> None:
    nodes = '{ name = "m2", value = 3.0 }, { name = "n1", value = 0 }, { name = "n2", value = 0 }]'
    first = '{ name = "d1", between = ["n1", "m2"], nominal = 1 }'
    second = '{ name = "d2", between = ["n2", "n1"], nominal = 1 }'
    held = changed(
        PRESS, ('{ name = "m2", value = 3.0 }]', nodes), ("damper = [", f"damper = [{first}, {second}, ")
    )
    assert faults(held) == {}
    loose = changed(held, ('["n1", "m2"], nominal = 1', '["n1", "m2"], nominal = 0'))
    assert faults(loose).keys() == {"model.mass[2].value", "model.mass[3].value"}


def test_driver_class_of_an_entry_point_is_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    assert driver_class("can") is FakeDriver
    with pytest.raises(ConfigError, match="drivers are can, gone, odd"):
        driver_class("none")
    monkeypatch.undo()
    assert {"modbus", "can", "serial"} <= set(plugins.driver_entries())


def test_driver_class_that_was_installed_since_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    monkeypatch.setattr(plugins, "_installed", cache(plugins._installed.__wrapped__))
    with pytest.raises(ConfigError, match="no driver is called"):
        driver_class("later")
    there = tmp_path / "later-1.0.dist-info"
    there.mkdir()
    (there / "METADATA").write_text("Metadata-Version: 2.1\nName: later\nVersion: 1.0\n", encoding="utf-8")
    named = "later = tests.unit.config.config_driver:FakeDriver"
    (there / "entry_points.txt").write_text(f"[{plugins.GROUP}]\n{named}\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    assert driver_class("later") is FakeDriver
