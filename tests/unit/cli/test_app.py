"""The command line itself: help, flags, errors, exit codes, plug-ins; bodies of commands are stood in for."""

import importlib.metadata
import io
import json
import logging
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import agent.commissioning
import agent.evaluation.demo
import agent.evaluation.paper
import agent.runtime
import agent.runtime.workers
from agent.cli.app import app
from agent.cli.terminal.errors import guarded, take_flags
from agent.cli.terminal.logs import OncePerPeriod
from agent.cli.terminal.streams import guarded_streams
from agent.errors import BusError, ConfigError, Fault, StoreError

Run = Callable[..., tuple[int, str, str]]
ROOMS = {
    "demo": agent.evaluation.demo, "check": agent.commissioning, "paper": agent.evaluation.paper,
    "running": agent.runtime.workers,
}  # fmt: skip
COMMANDS = ("demo", "paper", "check", "run", "replay", "estimates", "alarms", "trend", "sim")


@pytest.fixture
def deltak(capsys: pytest.CaptureFixture[str]) -> Iterator[Run]:
    """Run a command line in this process; gives exit code, stdout, stderr."""
    root, names = logging.getLogger(), list(logging.root.manager.loggerDict)
    handlers, level = root.handlers[:], root.level
    levels = {name: logging.getLogger(name).level for name in names}

    def run(*argv: str) -> tuple[int, str, str]:
        capsys.readouterr()
        code = guarded(app, argv)
        return (code, *capsys.readouterr())

    yield run
    logging.captureWarnings(capture=False)
    root.handlers[:], root.level = handlers, level
    for name, old in levels.items():
        logging.getLogger(name).setLevel(old)


@pytest.fixture
def body(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[dict[str, Any]]]:
    """Stand in for a command's body; returns the list of the keyword arguments it is called with."""

    def stand_in(module: str, function: str, result: Any) -> list[dict[str, Any]]:
        calls: list[dict[str, Any]] = []

        def called(**arguments: Any) -> Any:
            calls.append(arguments)
            if isinstance(result, BaseException):
                raise result
            return result

        room = ROOMS.get(module, agent.runtime)
        monkeypatch.setattr(room, module, SimpleNamespace(**{function: called}), raising=False)
        return calls

    return stand_in


RESULT = {
    "rig": "press-7", "db": "press 7.db", "run_id": 3, "span_s": 30.0, "windows": 596, "seconds": 0.1,
    "samples": {"received": 30000, "used": 29990, "rejected": {"crc": 10}, "dropped": {}, "gaps": 1},
    "estimates": {
        "k1": {"value": np.float64(25.04), "sd": 0.12, "lower": 24.8, "upper": 25.3, "delta": 0.04,
               "status": "valid", "reason": None, "t_ns": np.int64(30_000_000_001), "unit": "N/m",
               "n_valid": 590, "n_rows": 596},
        "B1": {"value": float("nan"), "sd": float("inf"), "lower": None, "upper": None, "delta": None,
               "status": "unexcited", "reason": "standstill", "t_ns": 30_000_000_001, "unit": "N s/m",
               "n_valid": 0,
               "n_rows": 596, "held": 5.1, "held_age_s": 12.0},
    },
    "alarms": [{"raised_at": "1970-01-01T00:00:10.500000000Z", "priority": "high", "state": "UNACK",
                "message": "k1 is 25.1 ± 0.9 N/m above nominal 25 (limit 15)"}],
    "samples_per_s": 300_000.0,
}  # fmt: skip
DEMO = RESULT | {
    "bus": "modbus TCP on 127.0.0.1:1502", "scenario": "table2",
    "truth": [{"from_s": 0, "to_s": 10, "parameters": {
        "k1": {"true": 25, "estimate": 25.04, "sd": 0.12, "bound_sd": 0.11, "error_sd": 0.333},
        "B1": {"true": 5, "estimate": None, "sd": None, "bound_sd": 0.2, "error_sd": None}}}],
    "alarm_delays": [{"parameter": "k1", "changed_s": 10, "raised_s": 10.5, "delay_s": 0.5},
                     {"parameter": "B1", "changed_s": 20, "raised_s": None, "delay_s": None}],
}  # fmt: skip


def test_help_names_every_command_with_one_line(deltak: Run) -> None:
    code, out, _ = deltak("--help")
    lines = {
        line.split()[0]: line.split()[1:]
        for line in out.splitlines()
        if line.startswith("  ") and line.split()
    }
    assert code == 0
    assert [name for name in COMMANDS if not lines.get(name)] == []
    assert "..." not in out.partition("First steps:")[2]


def test_help_answers_without_heavy_libraries() -> None:
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "agent", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    imported = {
        line.rsplit("|", 1)[-1].strip().split(".")[0] for line in done.stderr.splitlines() if "|" in line
    }
    assert "typer" in imported
    assert imported.isdisjoint(
        {"numpy", "scipy", "pydantic", "rich", "can", "pymodbus", "sqlite_utils", "matplotlib"}
    )


@pytest.mark.parametrize("command", COMMANDS[:-1])
def test_help_of_each_command_explains_every_option(deltak: Run, command: str) -> None:
    code, out, _ = deltak(command, "--help")
    options = [line for line in out.splitlines() if re.match(r"  -\S*[^.]( |$)", line)]
    assert code == 0
    assert len(options) >= 2
    assert [line for line in options if len(line.split()) < 3] == []


def test_version_is_the_packages(deltak: Run) -> None:
    assert deltak("--version") == (0, f"deltak {agent.__version__}\n", "")


def test_no_command_prints_the_help_on_stderr_and_exits_2(deltak: Run) -> None:
    code, out, err = deltak()
    assert (code, out) == (2, "")
    assert "Usage: deltak" in err


@pytest.mark.parametrize(
    ("argv", "place", "words"),
    [
        (["dmo"], "command line", "'demo'"),
        (["--nonsense"], "command line", "--nonsense"),
        (["trend"], "trend", "DB|TABLE"),
        (["estimates"], "estimates", "DB"),
        (["estimates", "a.db", "--sinse", "1d"], "estimates", "--since"),
        (["run", "a.toml", "--duration", "soon"], "run", "--duration"),
        (["run", "a.toml", "--duration", "-1"], "run", "--duration"),
        (
            ["demo", "--bus", "profibus"],
            "demo",
            "invalid value for '--bus': 'profibus' is not one of 'modbus'",
        ),
        (["alarms", "a.db", "--since", "1d"], "--since", "goes with --stats; add --stats"),
        (["estimates", "a.db", "--json", "--csv"], "--csv", "--json"),
        (["db"], "db", "missing command; give one of check, repair, compact, backup; see deltak db --help"),
    ],
)
def test_usage_error_is_one_line_and_exit_2(deltak: Run, argv: list[str], place: str, words: str) -> None:
    code, out, err = deltak(*argv)
    assert code == 2
    assert err.startswith(f"deltak: error: {place}: ")
    assert words in err
    assert err.count("\n") == 1
    assert out == "" if "--json" not in argv else json.loads(out)["errors"]


def test_json_usage_error_is_a_document_on_stdout_too(deltak: Run) -> None:
    code, out, err = deltak("trend", "--json")
    (error,) = json.loads(out)["errors"]
    assert (code, error["path"], error["advice"]) == (2, "trend", "see deltak trend --help")
    assert err == f"deltak: error: trend: {error['message']}; {error['advice']}\n"


FAULTS = [Fault("rig.sample_rate_hz", "0 is not above 0", "give it in Hz"), Fault("a.toml:3", "odd")]


@pytest.mark.parametrize(
    ("error", "code"), [(ConfigError(FAULTS), 2), (StoreError(FAULTS), 3), (BusError(FAULTS), 4)]
)
def test_agent_error_prints_every_fault_and_its_exit_code(
    deltak: Run, body: Any, error: Any, code: int
) -> None:
    body("replay", "replay", error)
    found, out, err = deltak("replay", "--json", "a.toml", "b.csv")
    assert found == code
    assert (
        err == "deltak: error: rig.sample_rate_hz: 0 is not above 0; give it in Hz\n"
        "deltak: error: a.toml:3: odd\n"
    )
    assert [e["path"] for e in json.loads(out)["errors"]] == ["rig.sample_rate_hz", "a.toml:3"]


def test_run_that_got_no_samples_says_so_and_asks_for_no_parameter(deltak: Run, body: Any) -> None:
    nothing = {"rig": "press", "db": "p.db", "span_s": 0.0, "samples": {}, "estimates": {}, "alarms": []}
    body("replay", "replay", nothing)
    code, out, _ = deltak("replay", "a.toml", "b.csv")
    assert code == 0
    assert "no estimates: not one hop of samples was whole" in out
    assert "alarms p.db" in out
    assert "trend" not in out


def test_unforeseen_error_is_a_short_line_and_exit_1(deltak: Run, body: Any) -> None:
    body("replay", "replay", ZeroDivisionError("division\nby zero"))
    code, out, err = deltak("replay", "a.toml", "b.csv")
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert "ZeroDivisionError: division by zero" in err


@pytest.mark.parametrize(
    "argv", [["--debug", "replay", "a.toml", "b.csv"], ["replay", "a.toml", "b.csv", "--debug"]]
)
def test_debug_shows_the_traceback_wherever_it_stands(deltak: Run, body: Any, argv: list[str]) -> None:
    body("replay", "replay", ZeroDivisionError("oh"))
    code, _, err = deltak(*argv)
    assert code == 1
    assert "Traceback" in err
    assert err.splitlines()[-1].startswith("deltak: error: unforeseen: ZeroDivisionError: oh")


def test_interrupt_exits_130(deltak: Run, body: Any) -> None:
    body("running", "run", KeyboardInterrupt())
    assert deltak("run", "a.toml") == (130, "", "deltak: interrupted\n")


def test_interrupt_signal_to_the_process_exits_130() -> None:
    script = (
        "import sys, threading, agent.runtime.workers\nfrom types import SimpleNamespace\n"
        "from agent.cli.app import main\n"
        "def run(**_):\n    print('ready', flush=True)\n    threading.Event().wait(60)\n"
        "agent.runtime.workers.running = SimpleNamespace(run=run)\nmain(['run', 'a.toml'])\n"
    )
    # a shell's background jobs are begun with SIGINT ignored, and this may be run by one
    command = ["env", "--default-signal=INT", sys.executable, "-c", script]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "ready\n"
        child.send_signal(signal.SIGINT)
        _, err = child.communicate(timeout=20)
    assert (child.returncode, err) == (130, "deltak: interrupted\n")


def test_interrupt_while_libraries_are_imported_exits_130() -> None:
    script = (
        "import sys\nclass Pressed:\n    def find_spec(self, name, path, target=None):\n"
        "        if name == 'agent.cli.app':\n            raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Pressed())\nfrom agent.cli.entry import main\nmain()\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "deltak: interrupted\n")


@pytest.mark.parametrize(("command", "code"), [("run", 2), ("check", -signal.SIGHUP)])
def test_hangup_while_libraries_are_imported_ends_no_agent(command: str, code: int, tmp_path: Path) -> None:
    script = (
        "import signal, sys\nsignal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup has it ignored\n"
        "class HungUp:\n    def find_spec(self, name, path, target=None):\n"
        "        if name == 'agent.cli.app':\n            signal.raise_signal(signal.SIGHUP)\n"
        "sys.meta_path.insert(0, HungUp())\nfrom agent.cli.entry import main\nmain()\n"
    )
    words = [command, str(tmp_path / "none.toml")]
    asked = [sys.executable, "-c", script, *words]
    done = subprocess.run(asked, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert ("none.toml: cannot be read" in done.stderr) == (command == "run")  # which went on


def test_reader_that_leaves_early_is_no_error() -> None:
    script = (
        "import agent.runtime\nfrom types import SimpleNamespace\nfrom agent.cli.app import main\n"
        "def replay(**_):\n    return {'rows': ['x' * 100] * 20000}\n"
        "agent.runtime.replay = SimpleNamespace(replay=replay)\nmain(['replay', 'a', 'b', '--json'])\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        assert child.stderr is not None
        child.stdout.read(10)
        child.stdout.close()
        assert child.stderr.read() == ""
        assert child.wait(timeout=20) == 0


def test_output_that_knows_fewer_characters_is_written_with_what_it_knows() -> None:
    output = io.TextIOWrapper(io.BytesIO(), encoding="latin-1")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "stdout", output)
        with guarded_streams():
            sys.stdout.write("k1 25.0 ± 0.1 … 25.2")
    output.seek(0)
    assert output.read() == "k1 25.0 ± 0.1 ? 25.2"


def test_bodies_are_called_with_keyword_arguments(deltak: Run, body: Any) -> None:
    calls = {
        "demo": body("demo", "demo", DEMO),
        "run": body("running", "run", RESULT),
        "replay": body("replay", "replay", RESULT),
        "check": body("check", "check", {"ok": True}),
        "paper": body("paper", "paper", {}),
    }
    for argv in (
        "demo --bus can --scenario paper --fast --db d.db",
        "run a.toml b.toml --db d.db --duration 5",
        "replay a.toml b.csv c.npz --db d.db",
        "check a.toml --recording b.csv --probe",
        "paper --window 250 --passes 8 --plot p.png",
    ):
        assert deltak(*argv.split(), "--json")[0] == 0
    plain = {name: {k: str(v) for k, v in found[0].items()} for name, found in calls.items()}
    two = "[PosixPath('a.toml'), PosixPath('b.toml')]"
    assert plain == {
        "demo": {"bus": "can", "scenario": "paper", "fast": "True", "db": "d.db", "rig": "two-mass"},
        "run": {"configs": two, "db": "d.db", "duration_s": "5.0", "kind": "live"},
        "replay": {
            "config": "a.toml",
            "recordings": "[PosixPath('b.csv'), PosixPath('c.npz')]",
            "db": "d.db",
        },
        "check": {"config": "a.toml", "recording": "b.csv", "probe": "True"},
        "paper": {"window": "250", "passes": "8", "plot": "p.png"},
    }


def test_replay_json_has_null_for_nan_and_time_beside_t_ns(deltak: Run, body: Any) -> None:
    body("replay", "replay", RESULT)
    _, out, err = deltak("replay", "a.toml", "b.csv", "--json")
    found = json.loads(out, parse_constant=pytest.fail)
    assert err == ""
    assert found["estimates"]["B1"]["value"] is None
    assert found["estimates"]["B1"]["sd"] is None
    assert found["estimates"]["k1"]["t_ns"] == 30_000_000_001
    assert found["estimates"]["k1"]["time"] == "1970-01-01T00:00:30.000000001Z"


def test_replay_table_names_values_status_samples_and_how_to_ask(deltak: Run, body: Any) -> None:
    body("replay", "replay", RESULT)
    _, out, _ = deltak("replay", "a.toml", "b.csv")
    for words in (
        "25.04 ± 0.12", "unexcited (standstill), held 5.1 since 12 s", "590 of 596",
        "k1 is 25.1 ± 0.9 N/m above",
        "30000 received, 29990 used, 10 rejected (10 crc), 0 dropped, 1 gap", "deltak trend 'press 7.db' k1",
    ):  # fmt: skip
        assert words in out


def test_run_of_several_configurations_prints_each(deltak: Run, body: Any) -> None:
    body("running", "run", {"runs": [RESULT, RESULT | {"rig": "press-8", "db": None, "alarms": []}]})
    _, out, _ = deltak("run", "a.toml", "b.toml")
    assert "rig press-7" in out
    assert "rig press-8" in out
    assert "no alarms" in out


def test_demo_table_holds_estimates_against_the_truth(deltak: Run, body: Any) -> None:
    body("demo", "demo", DEMO)
    _, out, _ = deltak("demo")
    for words in (
        "modbus TCP on 127.0.0.1:1502",
        "0 s to 10 s",
        "+0.33",
        "0.11",
        "0.5 s later",
        "B1",
        "not alarmed",
    ):
        assert words in out


def test_check_that_finds_faults_prints_document_and_lines_and_exits_2(deltak: Run, body: Any) -> None:
    document = {
        "ok": False,
        "errors": [{"path": "channel[2].at", "message": 'no mass is called "m3"', "advice": ""}],
    }
    body("check", "check", document)
    code, out, err = deltak("check", "a.toml", "--json")
    assert (code, json.loads(out)) == (2, document)
    assert err == 'deltak: error: channel[2].at: no mass is called "m3"\n'


def test_check_table_tells_what_the_document_holds(deltak: Run, body: Any) -> None:
    body(
        "check",
        "check",
        {
            "ok": True, "errors": [], "warnings": ["pole at 1"], "observable": True,
            "bytes_per_rig_year": 150e6,
            "poles": [{"re": 0.99, "im": -0.01, "freq_hz": 1.59, "damping_ratio": 0.7}],
            "condition_3": {"holds": True, "radius_model": 0.99, "radius_observer": 0.9},
            "condition_8": {"delta": 2.3e-4, "h_infinity": 4268.0, "perturbation_norm": 1e-3, "holds": False},
            "predicted_sd": [{"window_s": 0.25, "parameter": "k1", "sd": 0.5, "unit": "N/m",
                              "assumes": "white force"}],
        },
    )  # fmt: skip
    code, out, _ = deltak("check", "a.toml")
    assert code == 0
    for words in (
        "usable",
        "warning: pole at 1",
        "are observable",
        "1.59",
        "(3) holds",
        "(8) does not",
        "150 MB",
        "k1",
    ):
        assert words in out


def test_paper_table_is_the_modules_own(deltak: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    module = SimpleNamespace(
        paper=lambda **_: {"data": {"product": "exact"}}, table=lambda found: f"as {found['data']}"
    )
    monkeypatch.setattr(agent.evaluation.paper, "paper", module, raising=False)
    assert deltak("paper")[1] == "as {'product': 'exact'}\n"


PLUGIN = (
    '"""Heavy."""\nraise ImportError("half installed")\n\n'
    'def shake() -> None:\n    """Shake the rig gently."""\n'
)


@pytest.fixture
def plugins(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    """Three plug-ins: one works, one cannot be imported, one hides a built-in command."""
    (tmp_path / "broken_plugin.py").write_text(PLUGIN, encoding="utf-8")
    (tmp_path / "good_plugin.py").write_text(
        'def hello(name: str, loud: bool = False) -> None:\n    """Say hello."""\n    print(name, loud)\n',
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(tmp_path)
    values = {
        "shake": "broken_plugin:shake",
        "hello": "good_plugin:hello",
        "trend": "good_plugin:hello",
        "odd": "no:no",
    }
    points = [importlib.metadata.EntryPoint(name, value, "deltak.commands") for name, value in values.items()]
    monkeypatch.setattr("agent.cli.group.entry_points", lambda **_: points)


def test_plugin_command_runs_with_its_own_arguments(deltak: Run, plugins: None) -> None:
    assert deltak("hello", "Eva", "--loud") == (0, "Eva True\n", "")


def test_plugin_broken_is_listed_with_its_line_and_fails_alone(deltak: Run, plugins: None) -> None:
    sys.modules.pop("good_plugin", None)
    code, out, _ = deltak("--help")
    assert code == 0
    assert "Shake the rig gently." in out
    assert "Say hello." in out
    assert "good_plugin" not in sys.modules
    code, _, err = deltak("shake")
    assert code == 1
    assert "shake: cannot be loaded from broken_plugin:shake: ImportError: half installed" in err
    assert err.count("\n") == 1
    assert deltak("hello", "Eva")[0] == 0


def test_plugin_never_hides_a_built_in_command(deltak: Run, plugins: None) -> None:
    assert "drift" in deltak("trend", "--help")[1]


def test_take_flags_leaves_what_follows_two_dashes() -> None:
    args, flags = take_flags(["run", "-v", "a", "-vv", "--json", "--", "--debug", "-v"])
    assert args == ["run", "a", "--json", "--", "--debug", "-v"]
    assert (flags.verbose, flags.debug, flags.json) == (3, False, True)


def test_logs_go_to_stderr_and_warnings_need_no_flag(
    deltak: Run, body: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def replay(**_: Any) -> Any:
        logging.getLogger("agent.test").info("%s: progress", "bus")
        logging.getLogger("agent.test").warning("%s: silent", "bus")
        logging.getLogger("pymodbus.logging").error("noise")
        return RESULT

    monkeypatch.setattr(agent.runtime, "replay", SimpleNamespace(replay=replay), raising=False)
    quiet, loud = (deltak("replay", "a", "b", "--json", *flags)[2] for flags in ([], ["-v"]))
    assert quiet == "deltak: warning: bus: silent\n"
    assert loud == "deltak: info: bus: progress\n" + quiet


def test_once_per_period_holds_a_repeated_fault_back_and_counts_it() -> None:
    now = [0.0]
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    handler.addFilter(OncePerPeriod(now_s=lambda: now[0]))
    logger = logging.Logger("agent.test")  # noqa: LOG001 one that pytest does not listen to
    logger.addHandler(handler)
    for second in range(0, 121, 10):
        now[0] = float(second)
        logger.warning("%s: %d frames bad", "can0", second)
        logger.info("always")
    logger.warning("%s: %d frames bad", "can1", 5)
    lines = [line for line in stream.getvalue().splitlines() if line != "always"]
    assert lines == [
        "can0: 0 frames bad",
        "can0: 60 frames bad (5 more since the last line)",
        "can0: 120 frames bad (5 more since the last line)",
        "can1: 5 frames bad",
    ]
    assert stream.getvalue().count("always") == 13
