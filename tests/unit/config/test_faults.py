"""Every rule of CONTRACT section 3: what is changed in a right file, where the fault is, what it says."""

import re

import pytest
from pydantic import ValidationError

from agent.config.load import TABLES
from agent.config.reading.messages import faults_of
from drivers.can.bus.bus import BusKeys
from drivers.modbus.settings import ModbusSettings
from drivers.serial_port import SerialKeys
from tests.unit.config.config_texts import MINIMAL, MOTOR, PRESS, changed, faults, with_fake_driver


@pytest.fixture(autouse=True)
def _fake_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    with_fake_driver(monkeypatch)


# (old text, new text, key path, words that the fault must have)
PRESS_TABLE = [
    # keys and tables
    ('site = "hall 2"', 'sight = "hall 2"', "rig.sight", 'the nearest known key is "site"'),
    ("noise_sd = 1e-6", "nois_sd = 1e-6", "channel[1].nois_sd", 'the nearest known key is "noise_sd"'),
    ('observer = { gain = "auto" }', 'observer = { gian = "auto" }', "estimator.observer.gian", '"gain"'),
    ('{ name = "m1", value = 5.0 }', '{ name = "m1", valu = 5.0 }', "model.mass[0].valu", '"value"'),
    ('keep = { full = "7d"', 'keep = { ful = "7d"', "store.keep.ful", '"full"'),
    ("[store]", "[stores]", "stores", '"store"'),
    ("[store]", "[mqtt]\n[store]", "mqtt", "not in this version"),
    ("[store]", "[agent]\nworkers = -1\n[store]", "agent.workers", "must not be less than 0, not -1"),
    ("[store]", "[agent]\nround_s = 2\n[store]", "agent.round_s", "seconds from 0.005 to 1"),
    ("[store]", "[http]\nport = 80\n[store]", "http", "not in this version"),
    ("[store]", "[mqtt]\n[store]", "mqtt", "not in this version"),
    ("[store]", "[security]\n[store]", "security", "not in this version"),
    ("[store]", "[serve]\nport = 80\n[store]", "serve", "not in this version"),
    ("[store]", '[[north]]\nname = "a"\nkind = "opcua"\n[store]', "north[0].kind", "not in this version"),
    ("[[alarm]]", "[alarm]", "alarm", "must be a list of tables, not a table; write [[alarm]]"),
    ("[store]", "[store]\npassword = 'x'", "store.password", "secret"),
    # numbers that squares and products take out of the floating-point numbers
    ("value = 5.0", "value = 1e-308", "model.mass[0].value",
     "0 or between 1e-30 and 1e+30 in size, not 1e-308"),
    ("nominal = 25.0", "nominal = 1e300", "model.spring[0].nominal", "not 1e+300"),
    ("noise_sd = 1e-6", "noise_sd = 1e-200", "channel[1].noise_sd", "not 1e-200"),
    ("scale = 1.0", "scale = -1e31", "channel[0].scale", "not -1e+31"),
    ("window_s = 0.25", "window_s = 1e300", "estimator.window_s", "not 1e+300"),
    # rig
    ('name = "press-7"', 'name = "7press"', "rig.name", '"7press" is not a name'),
    ('name = "press-7"', 'name = "press 7"', "rig.name", "not a name"),
    ('name = "press-7"', f'name = "{"p" * 65}"', "rig.name", "not a name"),
    ('name = "press-7"', 'name = "press-7\\n"', "rig.name", "not a name"),
    ('name = "press-7"\n', "", "rig.name", "is missing; add it"),
    ("sample_rate_hz = 1000.0", "sample_rate_hz = 0", "rig.sample_rate_hz", "must be greater than 0, not 0"),
    ("sample_rate_hz = 1000.0", "sample_rate_hz = -1", "rig.sample_rate_hz",
     "must be greater than 0, not -1"),
    ("sample_rate_hz = 1000.0", "sample_rate_hz = inf", "rig.sample_rate_hz", "finite"),
    ("sample_rate_hz = 1000.0", 'sample_rate_hz = "1000"', "rig.sample_rate_hz", "without quotes"),
    ("sample_rate_hz = 1000.0", "sample_rate_hz = true", "rig.sample_rate_hz", "must be a number, not true"),
    ("sample_rate_hz = 1000.0\n", "", "rig.sample_rate_hz", "is missing"),
    ('clock = "counter"', 'clock = "sundial"', "rig.clock", "counter"),
    ('labels = { line = "A" }', "labels = { line = 1 }", "rig.labels.line", "must be text"),
    # model
    ('kind = "mass-spring-damper"', 'kind = "beam"', "model.kind",
     '"beam" is none of "mass-spring-damper", "linear"'),
    ("value = 5.0", "value = -5.0", "model.mass[0].value", "must not be less than 0, not -5"),
    ("value = 5.0", "value = nan", "model.mass[0].value", "finite"),
    ('name = "m2"', 'name = "m1"', "model.mass[1].name", '"m1" is the name of model.mass[0]'),
    ('name = "k2"', 'name = "m1"', "model.spring[1].name", '"m1" is the name of model.mass[0]'),
    ('name = "B2"', 'name = "k1"', "model.damper[1].name", '"k1" is the name of model.spring[0]'),
    ('name = "m2"', 'name = "ground"', "model.mass[1].name", "reserved"),
    ('name = "k2"', 'name = "ground"', "model.spring[1].name", "reserved"),
    ('"k2", between = ["m1", "m2"]', '"k2", between = ["m1", "m3"]', "model.spring[1].between[1]",
     'no mass is called "m3"; masses are m1, m2'),
    ('"k2", between = ["m1", "m2"]', '"k2", between = ["m1", "m1"]', "model.spring[1].between",
     'both ends are "m1"'),
    ('"k2", between = ["m1", "m2"]', '"k2", between = ["m1"]', "model.spring[1].between[1]", "missing"),
    ('"k2", between = ["m1", "m2"]', '"k2", between = "m1"', "model.spring[1].between", "must be a list"),
    ("nominal = 25.0", "nominal = -25.0", "model.spring[0].nominal", "must not be less than 0"),
    ("friction = []", "friction = 3", "model.friction", "must be a list of tables"),
    ("friction = []", "friction = [3]", "model.friction[0]", "must be a table, not 3"),
    ('{ name = "m2", value = 3.0 }]', '{ name = "m2", value = 3.0 }, { name = "m3", value = 0 }]',
     "model.mass[2].value", 'the massless node "m3" has no damper'),
    ('{ name = "m2", value = 3.0 }]', '{ name = "m2", value = 3.0 }, { name = "m3", value = 1 }]',
     "model.mass[2]", 'no channel measures "m3"'),
    # channels
    ('at = "m2"\nunit = "N"', 'at = "m3"\nunit = "N"', "channel[0].at",
     'no mass is called "m3"; masses are m1, m2'),
    ('at = "m1"\nunit = "m"', 'at = "ground"\nunit = "m"', "channel[1].at", 'no mass is called "ground"'),
    ('at = "m1"\n', "", "channel[1].at", "is missing"),
    ('quantity = "displacement"', 'quantity = "position"', "channel[1].quantity", '"displacement"'),
    ('quantity = "displacement"', 'quantity = "output"', "channel[1].quantity", "linear models"),
    ('name = "x2"', 'name = "x1"', "channel[2].name", '"x1" is the name of channel[1]'),
    ('name = "x2"', 'name = "t"', "channel[2].name", "reserved"),
    ('unit = "m"', 'unit = "kg"', "channel[1].unit", '"kg" is a unit of mass, not of displacement'),
    ('unit = "m"', 'unit = "N"', "channel[1].unit", "unit of force"),
    ('unit = "N"', 'unit = "mm"', "channel[0].unit", "unit of displacement"),
    ('unit = "m"', 'unit = "counts"', "channel[2].unit", 'does not go with "counts" of channel[1]'),
    ('unit = "m"\nnoise', "noise", "channel[1].unit", "is missing"),
    ('unit = "N"', 'unit = " "', "channel[0].unit", "must be a text"),
    ("noise_sd = 1e-6", "noise_sd = 0", "channel[1].noise_sd", "must be greater than 0, not 0"),
    ("noise_sd = 1e-6", "delay_s = -1", "channel[1].delay_s", "must not be less than 0"),
    ("scale = 1.0", "scale = 0", "channel[0].scale", "must not be 0"),
    ("scale = 1.0", "offset = nan", "channel[0].offset", "finite"),
    ("bias = false", 'bias = "no"', "channel[1].bias", "must be true or false"),
    ("bias = false", "gain = 1", "channel[1].gain", "must be true or false"),
    # what data sheets leave open
    ("value = 5.0 }", "value = 5.0, sd_percent = 0 }", None, ""),
    ("value = 5.0 }", "value = 5.0, sd_percnt = 2 }", "model.mass[0].sd_percnt",
     'nearest known key is "sd_percent"'),
    ("value = 5.0 }", "value = 5.0, sd_percent = -1 }", "model.mass[0].sd_percent",
     "must not be less than 0"),
    ("value = 5.0 }", "value = 5.0, sd_percent = 80 }", "model.mass[0].sd_percent",
     "at most 50 %, not 80; estimate"),
    ("noise_sd = 1e-6", "noise_sd = 1e-6\ngain_sd_percent = 200", "channel[1].gain_sd_percent",
     "at most 50 %"),
    ("noise_sd = 1e-6", "gain_sd_pct = 2", "channel[1].gain_sd_pct",
     'the nearest known key is "gain_sd_percent"'),
    ("bias = false", "gain = true\ngain_sd_percent = 2", "channel[1].gain_sd_percent",
     "takes it for unknown"),
    ("noise_sd = 1e-6", "noise_sd_spread = 0.1", "channel[1].noise_sd_spread",
     "no noise_sd that it could be of"),
    ("noise_sd = 1e-6", "noise_sd = 1e-6\nnoise_sd_spread = 30", "channel[1].noise_sd_spread", "0.3 is 30 %"),
    ("noise_sd = 1e-6", "noise_sd = 1e-6\nnoise_sd_spread = 0", "channel[1].noise_sd_spread",
     "greater than 0"),
    ("noise_sd = 1e-6", "delay_sd_s = 0.001", None, ""),
    ("noise_sd = 1e-6", "delay_sd_s = 0", None, ""),
    ("scale = 1.0", "delay_sd_s = 0.001", None, ""),
    # estimator
    ('hold = "first"', 'hold = "quintic"', None, ""),
    ('method = "window-ml"', 'method = "magic"', "estimator.method", '"window-ml"'),
    ('method = "window-ml"', 'method = "ekf"', "estimator.method", "not in this version"),
    ("window_s = 0.25", "window_s = 0", "estimator.window_s", "must be greater than 0"),
    ("window_s = 0.25", 'window_s = "long"', "estimator.window_s", '"auto"'),
    ("window_s = 0.25", "window_s = []", "estimator.window_s", "at least one"),
    ("window_s = 0.25", "window_s = [1, 1.0]", "estimator.window_s", "different"),
    ("window_s = 0.25", "window_s = [0.5, true]", "estimator.window_s", "not true"),
    ("window_s = 0.25", "window_s = 0.004", "estimator.window_s",
     "4 samples; 4 parameters and 4 states need"),
    ("window_s = 0.25", "window_s = [0.5, 0.004]", "estimator.window_s[1]", "4 samples"),
    ("hop_s = 0.05", "hop_s = 0.0001", "estimator.hop_s", "less than a sample"),
    ("hop_s = 0.05", "hop_s = 1", "estimator.hop_s", "longer than the window"),
    ("hop_s = 0.05", "hop_s = 0.05\ndrift_s = 1.0", "estimator.drift_s", "followed without it"),
    ("hop_s = 0.05", "hop_s = 0", "estimator.hop_s", "must be greater than 0"),
    ('hold = "first"', 'hold = "second"', "estimator.hold", '"first", "zero", "cubic", "quintic"'),
    ('"B1", "B2"]\nobserver', '"B1", "B3"]\nobserver', "estimator.estimate[3]", 'the nearest is "B'),
    ('"B1", "B2"]\nobserver', '"B1", "B1"]\nobserver', "estimator.estimate[3]", "named twice"),
    ('"B1", "B2"]\nobserver', '"B1", "x3.bias"]\nobserver', "estimator.estimate[3]",
     "no parameter is called"),
    ('estimate = ["k1", "k2", "B1", "B2"]', "estimate = []", "estimator.estimate", "at least 1"),
    ('gain = "auto"', 'gain = "best"', "estimator.observer.gain", '"auto", "poles", "kalman"'),
    ('gain = "auto"', 'gain = "poles"', "estimator.observer.poles", 'gain = "poles" needs it'),
    ('gain = "auto"', 'gain = "kalman"', "estimator.observer.process_sd", 'gain = "kalman" needs it'),
    ('gain = "auto"', 'gain = "auto", poles = [-1]', "estimator.observer.poles", 'goes with gain = "poles"'),
    ('gain = "auto"', 'gain = "poles", poles = [-1, -2, -3]', "estimator.observer.poles",
     "3 poles for 4 states"),
    ('gain = "auto"', 'gain = "poles", poles = [-4, -4, -4, -1]', "estimator.observer.poles",
     "stands there 3 times"),
    ("window_s = 0.25", "window_s = 1e9", "estimator.window_s", "GB of memory"),
    ("window_s = 0.25", "window_s = 20000", "estimator.window_s",
     "2e+07 samples, which take about 21 GB of memory"),
    ('gain = "auto"', 'gain = "poles", poles = [-1, -2, -3, 4]', "estimator.observer.poles[3]", "negative"),
    ('gain = "auto"', 'gain = "kalman", process_sd = [1]', "estimator.observer.process_sd",
     "1 numbers for 2"),
    ('gain = "auto"', 'gain = "kalman", process_sd = -1', "estimator.observer.process_sd", "greater than 0"),
    ("resolve = 0.33", "resolve = 0", "estimator.resolve", "must be greater than 0"),
    ("resolve = 0.33", "passes = 0", "estimator.passes", "must not be less than 1"),
    ("resolve = 0.33", "passes = 1.5", "estimator.passes", "whole number"),
    # alarms
    ("limit = 15.0", "limit = 15.0\nlimit_percent = 10", "alarm[0]", "both limit and limit_percent"),
    ("limit = 15.0\n", "", "alarm[0]", "has no limit; give exactly one"),
    ("limit = 15.0", "limit = 0", "alarm[0].limit", "must be greater than 0"),
    ("limit = 15.0", "limit_percent = -1", "alarm[0].limit_percent", "must be greater than 0"),
    ('parameter = "k1"', 'parameter = "m1"', "alarm[0].parameter", '"m1" is not estimated; add it'),
    ('parameter = "k1"', 'parameter = "k9"', "alarm[0].parameter", 'no parameter is called "k9"'),
    ('parameter = "k1"\n', "", "alarm[0].parameter", "is missing"),
    ('side = "both"', 'side = "up"', "alarm[0].side", '"both", "low", "high"'),
    ("confidence = 0.95", "confidence = 1.0", "alarm[0].confidence", "must be less than 1"),
    ("confidence = 0.95", "confidence = 95", "alarm[0].confidence", "must be less than 1"),
    ("confidence = 0.95", "confidence = 0.4", "alarm[0].confidence", "must not be less than 0.5"),
    ("deadband = 1.5", "deadband = 15", "alarm[0].deadband", "never clear"),
    ("on_delay_s = 0.2", "on_delay_s = -1", "alarm[0].on_delay_s", "must not be less than 0"),
    ("off_delay_s = 2.0", 'off_delay_s = "2"', "alarm[0].off_delay_s", "must be a number"),
    ('priority = "high"', 'priority = "urgent"', "alarm[0].priority", '"critical"'),
    ('priority = "high"', 'kind = "sensor"', "alarm[0].kind", "not in this version"),
    ('priority = "high"', 'kind = "forecast"', "alarm[0].within",
     'kind = "forecast" needs it; write within = "30d"'),
    ('priority = "high"', 'kind = "rate"', "alarm[0].rate_per_day", "needs it; write rate_per_day = 0.5"),
    ('priority = "high"', 'within = "forever"', "alarm[0].within", "is no time"),
    ('priority = "high"', "within = 30", "alarm[0].within", "such as"),
    ('priority = "high"', "rate_per_day = 0", "alarm[0].rate_per_day", "must be greater than 0"),
    ('priority = "high"', 'within = "30d"', None, ""),
    ("limit = 15.0", "rate_per_day = 0.5", None, ""),
    ("limit = 15.0", 'within = "30d"', "alarm[0].within", "give limit or limit_percent"),
    ("[[source]]", '[[alarm]]\nparameter = "k1"\nrate_per_day = 3\n[[source]]', None, ""),
    ("[[source]]", '[[alarm]]\nparameter = "k1"\nkind = "forecast"\nlimit = 3\nwithin = "9d"\n[[source]]',
     None, ""),
    # forecasts
    ("[store]", '[forecast]\nevry = "1h"\n[store]', "forecast.evry", 'the nearest known key is "every"'),
    ("[store]", "[forecast]\nevery = 60\n[store]", "forecast.every", "such as"),
    ("[store]", '[forecast]\nevery = "0.1s"\n[store]', "forecast.every", "is too often"),
    ("[store]", '[forecast]\nhorizon = "forever"\n[store]', "forecast.horizon", "is no horizon"),
    ("[store]", '[forecast]\nlike = ["gone.json"]\n[store]', "forecast.like[0]", "there is no file"),
    ("[store]", '[forecast]\nlike = "gone.json"\n[store]', "forecast.like", "must be a list"),
    ("[store]", '[forecast]\nevery = "10s"\nhorizon = "90d"\n[store]', None, ""),
    ("[[source]]", '[[alarm]]\nparameter = "k1"\nlimit = 3\n[[source]]', "alarm[1].parameter", "already"),
    # sources
    ('driver = "can"', 'driver = "profibus"', "source[0].driver", "drivers are can, gone, odd"),
    ('driver = "can"', 'driver = "gone"', "source[0].driver", "cannot be loaded"),
    ('driver = "can"', 'driver = "odd"', "source[0].driver", "is no driver"),
    ('driver = "can"\n', "", "source[0].driver", "is missing"),
    ('dbc = "press7.dbc"', 'dcb = "press7.dbc"', "source[0].dcb", 'the nearest known key is "dbc"'),
    ('dbc = "press7.dbc"', "", "source[0]", "names of signals are missing; give dbc or fields"),
    ('interface = "socketcan"', 'interface = "pcan"', "source[0].interface", '"socketcan", "socketcand"'),
    ('channel = "can0"', "bitrate = 0", "source[0].bitrate", "must be greater than 0"),
    ('channel = "can0"', "port = []", "source[0].port", "must be"),
    ('dbc = "press7.dbc"', 'fields = [{ name = "a", type = "int7" }]', "source[0].fields[0].type", '"int16"'),
    ('dbc = "press7.dbc"', 'fields = [{ nam = "a", type = "int16" }]', "source[0].fields[0].nam", '"name"'),
    (', x2 = "RIG_SAMPLE.X2" }', " }", "channel[2]", 'no source maps "x2"'),
    ("x2 = ", "x3 = ", "source[0].map.x3", 'no channel is called "x3"; channels are force, x1, x2'),
    ("x2 = ", "x3 = ", "channel[2]", 'no source maps "x2"'),
    ('x2 = "RIG_SAMPLE.X2"', "x2 = 3", "source[0].map.x2", "must be text"),
    ('counter = "RIG', 'stale_s = 0 # "RIG', "source[0].stale_s", "must be greater than 0"),
    ('counter = "RIG', 'record = "yes" # "RIG', "source[0].record", "must be true or false"),
    ("[store]",
     '[[source]]\ndriver = "can"\ninterface = "socketcan"\ndbc = "b.dbc"\nmap = { x1 = "B.x" }\n[store]',
     "source[1].map.x1", '"x1" is mapped by source[0] already'),
    ('driver = "can"', 'driver = "can"\nname = "bad name"', "source[0].name", "not a name"),
    # store and columns
    ('path = "press-7.db"', "path = 5", "store.path", "must be a path"),
    ('path = "press-7.db"', 'path = ""', "store.path", "must be a text"),
    ("every_s = 1.0", "every_s = -1", "store.every_s", "must not be less than 0"),
    ('full = "7d"', 'full = "a week"', "store.keep.full", "such as"),
    ('full = "7d"', "full = 7", "store.keep.full", "such as"),
    ('full = "7d"', "full = nan", "store.keep.full", "not nan"),
    ('full = "7d"', "full = -1.0", "store.keep.full", "not -1.0"),
    ("[store]", "[forecast]\nhorizon = -1e308\n[store]", "forecast.horizon", "such as"),
    ('minute = "90d"', 'minute = "0d"', "store.keep.minute", "such as"),
    ("max_mb = 1024", "max_mb = 0", "store.max_mb", "must be greater than 0"),
    ("[store]", '[columns]\nx9 = "b"\n[store]', "columns.x9", 'no channel is called "x9"'),
    ("[store]", '[columns]\nx1 = "b"\nx2 = "b"\n[store]', "columns.x2", '"b" is the column of x1 already'),
    ("[store]", "[columns]\nx1 = 9\n[store]", "columns.x1", "must be a column's name"),
    ("[store]", '[columns]\ndelimiter = "|"\n[store]', "columns.delimiter", "comma, semicolon and tab"),
]  # fmt: skip

MINIMAL_TABLE = [
    ("value = 2 }", "value = 0 }", None, ""),
    ("[[channel]]", "b = 3\n[[channel]]", "model.b", "unknown key"),
    ("nominal = 3", "nominal = 3 }]\nfriction = [{ name = 'f', between = ['m', 'ground'], nominal = 1",
     None, ""),
    ("mass = [{ name = \"m\", value = 2 }]", "mass = []", "model.mass", "is missing"),
    ('quantity = "displacement"', 'quantity = "force"', "channel", "nothing is measured"),
    ('quantity = "displacement"', 'quantity = "displacement"\ndelay_sd_s = 0.001', "channel[0].delay_sd_s",
     "the only reading of the motion"),
    ("[[channel]]", "[channel]", "channel", "write [[channel]]"),
    ("[rig]", "[model.x]\n[rig]", "model.x", "unknown key"),
]  # fmt: skip

MOTOR_TABLE = [
    ("A = [[-2.0, -50.0], [5.0, -0.1]]", "A = [[-2.0, -50.0], [5.0]]", "model.A", "uneven"),
    ("A = [[-2.0, -50.0], [5.0, -0.1]]", "A = []", "model.A", "has no rows"),
    ("A = [[-2.0, -50.0], [5.0, -0.1]]\n", "", "model.A", "is missing"),
    ("-50.0", '"x"', "model.A[0][1]", "must be a number"),
    ("B = [[100.0], [0.0]]", "B = [[100.0, 1.0], [0.0, 1.0]]", "model.B", "input channels 1"),
    ("C = [[1.0, 0.0], [0.0, 1.0]]", "C = [[1.0, 0.0]]", "model.C", "output channels 2"),
    ("dA = [[-1.0, 0.0], [0.0, 0.0]]", "dA = [[-1.0]]", "model.parameter[0].dA", "2 rows of 2 columns fit"),
    ("dA = [[-1.0, 0.0], [0.0, 0.0]]", "dB = [[-1.0, 0.0]]", "model.parameter[0].dB",
     "2 rows of 1 columns fit"),
    (", dA = [[-1.0, 0.0], [0.0, 0.0]]", "", "model.parameter[0]", "it changes nothing"),
    ('name = "voltage"', 'name = "voltage"\nat = "m1"', "channel[0].at", "no masses"),
    ("parameter = [", "parameters = [", "model.parameters", '"parameter"'),
    ("parameter = [", "parameter = [1, ", "model.parameter[0]", "must be a table, not 1"),
    ("parameter = [", 'parameter = [{ name = "R", nominal = 1.0, dB = [[1.0], [0.0]] }, ',
     "model.parameter[1].name", '"R" is the name of model.parameter[0]'),
]  # fmt: skip

ROWS = [
    (base, *row)
    for base, rows in ((PRESS, PRESS_TABLE), (MINIMAL, MINIMAL_TABLE), (MOTOR, MOTOR_TABLE))
    for row in rows
]


def test_config_output_that_may_be_late_goes_with_forces_that_run_straight() -> None:
    commanded = (('hold = "first"', 'hold = "zero"'), ("noise_sd = 1e-6", "delay_sd_s = 0.001"))
    found = faults(changed(PRESS, *commanded))["channel[1].delay_sd_s"]
    assert 'goes with hold = "first", not "zero"' in found


@pytest.mark.parametrize(("base", "old", "new", "path", "words"), ROWS, ids=lambda value: str(value)[:40])
def test_config_with_one_change_names_path_and_rule(
    base: str, old: str, new: str, path: str | None, words: str
) -> None:
    found = faults(changed(base, (old, new)))
    if path is None:
        assert found == {}
    else:
        assert path in found, f"faults are {list(found.values())}"
        assert words in found[path]


@pytest.mark.parametrize("base", [PRESS, MINIMAL, MOTOR], ids=["press", "minimal", "motor"])
def test_config_unchanged_has_no_fault(base: str) -> None:
    assert faults(base) == {}


OTHER_FAULTS_OF_THE_SAME_KEY = {"value = 1e-308", "noise_sd = 1e-200", "scale = -1e31"}


def test_config_with_many_changes_names_every_one() -> None:
    rows = {
        (old, new, path)
        for old, new, path, _ in PRESS_TABLE
        if path in {"rig.sight", "model.mass[0].value", "channel[0].at", "channel[0].scale",
                    "channel[1].noise_sd", "estimator.hold", "alarm[0].side", "source[0].dcb", "store.max_mb",
                    "mqtt", "channel[2]"}
        and "nan" not in new and "x3" not in new and new not in OTHER_FAULTS_OF_THE_SAME_KEY
    }  # fmt: skip
    changes = [("[store]", "[mqtt]\n[store]")] + [
        (old, new) for old, new, path in sorted(rows) if path != "mqtt"
    ]
    assert {path for _, _, path in rows} <= set(faults(changed(PRESS, *changes)))


@pytest.mark.parametrize(
    ("estimate", "path"), [('"m1"', "model.mass[0].sd_percent"), ('"x1.gain"', "channel[1].gain_sd_percent")]
)
def test_config_data_sheet_of_what_is_estimated_is_refused(estimate: str, path: str) -> None:
    stated = changed(
        PRESS, ("value = 5.0 }", "value = 5.0, sd_percent = 3 }"), ("noise_sd = 1e-6", "gain_sd_percent = 3")
    )
    assert faults(stated) == {}
    found = faults(changed(stated, ('"B1", "B2"]\nobserver', f'"B1", {estimate}]\nobserver')))
    assert list(found) == [path]
    assert "takes it for unknown" in found[path]


def test_config_polynomial_hold_is_refused_for_the_method_that_cannot_wait() -> None:
    found = faults(
        changed(PRESS, ('method = "window-ml"', 'method = "seed"'), ('hold = "first"', 'hold = "cubic"'))
    )
    assert "readings that come after" in found["estimator.hold"]


def test_config_massless_node_has_no_data_sheet() -> None:
    massless = '{ name = "m2", value = 3.0 }, { name = "m3", value = 0, sd_percent = 2 }]'
    found = faults(changed(PRESS, ('{ name = "m2", value = 3.0 }]', massless)))
    assert "massless node" in found["model.mass[2].sd_percent"]


def test_config_channel_at_unknown_mass_reads_as_the_contract_writes_it() -> None:
    found = faults(changed(PRESS, ('at = "m2"\nunit = "m"', 'at = "m3"\nunit = "m"')))
    assert list(found.values()) == ['channel[2].at: no mass is called "m3"; masses are m1, m2']


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ((("nominal = 25.0", "nominal = 0.0"),), "k1"),
        (
            (
                ('estimate = ["k1"', 'estimate = ["x1.bias", "k1"'),
                ('parameter = "k1"', 'parameter = "x1.bias"'),
            ),
            "x1.bias",
        ),
    ],
)
def test_config_limit_that_is_a_share_of_nothing_is_refused(
    changes: tuple[tuple[str, str], ...], name: str
) -> None:
    text = changed(PRESS, ("limit = 15.0", "limit_percent = 10"), ("deadband = 1.5\n", ""), *changes)
    words = f'a share of the nominal of "{name}", which is 0; give limit in the parameter\'s unit'
    assert words in faults(text)["alarm[0].limit_percent"]


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"parity": "x"}, 'parity: "x" is none of "N", "E", "O", "M", "S"'),
        ({"port": ""}, "port: must not be empty"),
        ({"port": "/dev/tty\0S0"}, "port: must not hold a zero byte"),
        ({"baudrate": 1e308}, "baudrate: must be a whole number of at most 64 bits, not 1e+308"),
        ({"baudrate": True}, "baudrate: must be a whole number, not true; write it without quotes"),
        ({"baudrate": "9600"}, 'baudrate: must be a whole number, not "9600"; write it without quotes'),
    ],
)
def test_faults_of_keys_of_a_serial_line_are_said_in_words(keys: dict[str, object], expected: str) -> None:
    with pytest.raises(ValidationError) as caught:
        SerialKeys.model_validate({"port": "/dev/ttyS0", **keys})
    (fault,) = faults_of(caught.value, "", keys)
    assert str(fault).startswith(expected)


def test_interface_that_is_no_name_is_said_with_an_example() -> None:
    keys = {"interface": "CAN 0", "channel": "can0"}
    with pytest.raises(ValidationError) as caught:
        BusKeys.model_validate(keys)
    (fault,) = faults_of(caught.value, "", keys)
    assert str(fault) == 'interface: must be the name of an interface, such as "socketcan"'


def test_fault_of_one_key_of_a_modbus_source_is_one_sentence() -> None:
    raw = {"mode": "poll", "baudrate": -1, "fields": [{"name": "x", "type": "int16"}]}
    with pytest.raises(ValidationError) as caught:
        ModbusSettings.model_validate(raw)
    assert [fault.path for fault in faults_of(caught.value, "", raw)] == ["baudrate"]


@pytest.mark.parametrize(
    ("change", "field", "expected"),
    [
        ({"share": 1}, {}, "share: must be true or false, not 1"),
        ({"gap": "8"}, {}, 'gap: must be a whole number, not "8"'),
        ({"timeout_s": True}, {}, "timeout_s: must be a number, not true"),
        ({"period_s": float("inf")}, {}, "period_s: must be a finite number, not inf"),
        ({}, {"address": True}, "fields[0].address: must be a whole number, not true"),
        ({}, {"scale": True}, "fields[0].scale: must be a number, not true"),
        ({}, {"scale": "2"}, 'fields[0].scale: must be a number, not "2"'),
        ({}, {"scale": 0}, "fields[0].scale: must not be 0: it would make every sample the same"),
    ],
)
def test_fault_of_a_key_of_a_modbus_source_of_the_wrong_kind_names_it(
    change: dict[str, object], field: dict[str, object], expected: str
) -> None:
    raw = {"mode": "poll", "fields": [{"name": "x", "type": "int16", "address": 0, **field}], **change}
    with pytest.raises(ValidationError) as caught:
        ModbusSettings.model_validate(raw)
    (fault,) = faults_of(caught.value, "", raw)
    assert str(fault).startswith(expected)


@pytest.mark.parametrize("table", TABLES)
def test_config_something_else_in_place_of_a_table_is_one_fault_of_that_table(table: str) -> None:
    headers = rf"\[\[?{table}\]\]?\n(?:[^\[].*\n|\n)*"
    text = f"{table} = true\n" + re.sub(headers, "", PRESS)
    found = {path: words for path, words in faults(text).items() if path.split(".")[0] == table}
    assert list(found) == [table]
    assert found[table].startswith(f"{table}: must be a ")
