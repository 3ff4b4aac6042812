"""Channels of role covariate and the table [baseline]."""

from pathlib import Path

import pytest

from agent.config import learnt_key, load
from agent.errors import ConfigError
from tests.peers import ROOT

TEXT = (ROOT / "deploy/examples/modbus.toml").read_text(encoding="utf-8")
HALL = """
[[channel]]
name = "hall"
role = "covariate"
quantity = "temperature"
unit = "degC"
"""
THERMOMETER = """
[[source]]
name = "thermometer"
driver = "serial"
port = "thermometer.pty"
baudrate = 9600
format = "text"
columns = ["T"]
stale_s = 3600.0
map = { hall = "T" }
"""


def put(folder: Path, *tables: str) -> Path:
    path = folder / "rig.toml"
    path.write_text("\n".join([TEXT, *tables]), encoding="utf-8")
    return path


def faults_of(path: Path) -> dict[str, str]:
    with pytest.raises(ConfigError) as caught:
        load(path)
    return {fault.path: fault.message for fault in caught.value.faults}


def test_covariate_is_no_channel_of_the_model_and_its_source_shares_no_connection(tmp_path: Path) -> None:
    plain = load(put(tmp_path))
    config = load(put(tmp_path, HALL, THERMOMETER, "[baseline]\ncovariates = ['hall']\ndays = 3.0\n"))
    assert [channel.name for channel in config.channel] == [channel.name for channel in plain.channel]
    assert learnt_key(config) == learnt_key(plain)
    assert [one.name for one in config.covariate] == ["hall"]
    assert [source.name for source in config.source] == [source.name for source in plain.source]
    (thermometer,) = config.covariate_source
    assert thermometer.covariates == {"hall": "T"}
    assert thermometer.fields == ("T",)
    assert config.baseline.days == 3.0


def test_covariate_may_come_with_the_signals(tmp_path: Path) -> None:
    config = load(put(tmp_path).rename(tmp_path / "plain.toml"))
    field = next(iter(config.source[0].map.values()))
    path = put(tmp_path, HALL)
    path.write_text(path.read_text().replace("map = {", f'map = {{ hall = "{field}",'), encoding="utf-8")
    mixed = load(path)
    assert mixed.covariate_source == ()
    assert mixed.source[0].covariates == {"hall": field}
    assert "hall" not in mixed.source[0].map
    assert mixed.source[0].fields[-1] == field


def test_faults_of_covariates_name_their_keys(tmp_path: Path) -> None:
    wrong = HALL.replace('"hall"', '"x1"') + "range = [30.0, 10.0]\nnoise_sd = 1.0\n"
    odd = HALL.replace('"covariate"', '"cofactor"')
    found = faults_of(put(tmp_path, wrong, odd, "[baseline]\ncovariates = ['load']\nclasses = 0\n"))
    assert "is the name of channel" in found["channel[3].name"]
    assert found["channel[3].range"] == "must rise"
    assert "unknown key" in found["channel[3].noise_sd"]
    assert (
        'is none of "signal" and "covariate"' in found["channel[4].role"]
        or "cofactor" in found["channel[4].role"]
    )
    assert found["baseline.covariates"] == 'no covariate is called "load"'
    assert "baseline.classes" in found


def test_covariate_without_a_source_is_missed_as_any_channel_is(tmp_path: Path) -> None:
    assert faults_of(put(tmp_path, HALL))["channel[3]"] == 'no source maps "hall"'
