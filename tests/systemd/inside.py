"""Installs the service as the runbook says and lives through a day with it, under a real systemd.

A plain script with the standard library alone: test_systemd.py asserts what it leaves behind.
"""

import grp
import http.client
import importlib.util
import json
import os
import pwd
import shutil
import socket
import sqlite3
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

HERE, ROOT = Path(__file__).parent, Path(__file__).parents[2]
PACKAGES = Path(str(importlib.util.find_spec("numpy").origin)).parents[1]
"""Where this interpreter finds what the agent imports, which an environment may share with others."""
DB = Path("/var/lib/deltak/deltak.db")
CONFIGS = Path("/etc/deltak/conf.d")
HANG = Path("/run/deltak-hang")
LIMIT_S = 120.0
WATCHDOG_S = 6
WHOLE = bool(os.environ.get("DELTAK_WHOLE"))
"""Whether to wait for what a restart takes, which is as long as all else together."""
RIG = """
[rig]
name = "{name}"
sample_rate_hz = 20.0
clock = "{clock}"
[model]
mass = [{{ name = "m1", value = 5.0 }}]
spring = [{{ name = "k1", between = ["ground", "m1"], nominal = 25.0 }}]
damper = [{{ name = "B1", between = ["ground", "m1"], nominal = 5.0 }}]
[[channel]]
name = "force"
quantity = "force"
at = "m1"
unit = "N"
[[channel]]
name = "x1"
quantity = "displacement"
at = "m1"
unit = "m"
noise_sd = 1e-3
[estimator]
window_s = 1.0
hop_s = 0.25
[store]
every_s = 0
[[source]]
"""
SOURCES = {
    "can": ("arrival", """
driver = "can"
interface = "socketcan"
channel = "vcan0"
dbc = "two-mass-rig.dbc"
map = { force = "RIG_SAMPLE.Force", x1 = "RIG_SAMPLE.X1" }
"""),
    "line": ("counter", """
driver = "hanging"
port = "/run/deltak-line"
baudrate = 115200
format = "text"
columns = ["n", "force", "x1", "x2"]
map = { force = "force", x1 = "x1" }
counter = "n"
"""),
    "plc": ("arrival", """
driver = "modbus"
transport = "tcp"
host = "127.0.0.1"
port = 1502
mode = "poll"
period_s = 0.05
fields = [{ name = "force", address = 1, type = "int16" }, { name = "x1", address = 2, type = "int16" }]
map = { force = "force", x1 = "x1" }
"""),
}  # fmt: skip
PYTHON = """
[Service]
Environment=PYTHONHOME=/opt/python PYTHONPATH=/opt/project:/opt/packages:/opt/hanging \
LD_LIBRARY_PATH=/opt/python/lib
StandardOutput=null
StandardError=append:/run/deltak.log
"""
DROP_IN = """
WatchdogSec={watchdog}
RestartSec={pause}
"""
OWN = ""
"""What a script's agent is run with instead."""
TOKEN = "a token of the page in a guest"
PAGE = """
RuntimeDirectory=deltak-page
ExecStartPre=+/bin/cp /etc/deltak/secrets/page.token /run/deltak-page
ExecStartPre=+/bin/chown --reference=/run/deltak-page /run/deltak-page/page.token
ExecStart=
ExecStart=/opt/deltak/bin/deltak serve --db /var/lib/deltak/deltak.db --config /etc/deltak/conf.d \\
  --token-file /run/deltak-page/page.token
"""
"""As the runbook has it, but for LoadCredential: the guest's kernel has neither of what systemd hands a
credential to another user than root by (a file system of its own, access lists)."""


def until(condition: Callable[[], object], what: str) -> float:
    """Wait for a condition; return how long it took, s."""
    begun = time.monotonic()
    while not condition():
        if time.monotonic() - begun > LIMIT_S:
            log = Path("/run/deltak.log")
            sys.stdout.write(log.read_text() if log.exists() else "no log\n")
            sys.stdout.write(systemctl("status", "deltak", "--no-pager", check=False))
            raise SystemExit(f"after {LIMIT_S:g} s: not {what}")
        time.sleep(0.5)
    return time.monotonic() - begun


def systemctl(*words: str, check: bool = True) -> str:
    return subprocess.run(["systemctl", *words], check=check, capture_output=True, text=True).stdout


def shown(name: str) -> str:
    return systemctl("show", "deltak", f"--property={name}", "--value").strip()


def ended_by_watchdog() -> bool:
    return shown("NRestarts") == "1" if WHOLE else shown("Result") == "watchdog"


def install() -> None:
    """Put everything where the runbook puts it; the program is this machine's, under /opt."""
    for unit in ("deltak.service", "deltak-page.service", "deltak-opcua.service"):
        shutil.copy(ROOT / "deploy/systemd" / unit, f"/etc/systemd/system/{unit}")
    shutil.copy(ROOT / "deploy/systemd/deltak.sysusers", "/usr/lib/sysusers.d/deltak.conf")
    shutil.copy(ROOT / "deploy/systemd/deltak.tmpfiles", "/usr/lib/tmpfiles.d/deltak.conf")
    subprocess.run(["systemd-sysusers", "deltak.conf"], check=True)
    subprocess.run(["systemd-tmpfiles", "--create", "deltak.conf"], check=True)
    places = {"python": sys.base_prefix, "project": ROOT, "packages": PACKAGES,
              "hanging": HERE / "hanging"}  # fmt: skip
    for name, source in places.items():
        target = Path("/opt", name)
        target.mkdir(parents=True)
        subprocess.run(["mount", "--bind", source, target], check=True)
    command = Path("/opt/deltak/bin/deltak")
    command.parent.mkdir(parents=True)
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    command.write_text(f'#!/bin/sh\nexec /opt/python/bin/{version} -m agent "$@"\n')
    command.chmod(0o755)
    watched = DROP_IN.format(watchdog=WATCHDOG_S, pause=0.2 if WHOLE else 300)
    own = {"deltak": OWN or watched, "deltak-page": PAGE, "deltak-opcua": ""}
    for name, text in own.items():
        drop_in = Path(f"/etc/systemd/system/{name}.service.d/test.conf")
        drop_in.parent.mkdir()
        drop_in.write_text(PYTHON + text)
    token = Path("/etc/deltak/secrets/page.token")
    token.write_text(TOKEN)
    token.chmod(0o600)
    shutil.copy(ROOT / "deploy/examples/two-mass-rig.dbc", CONFIGS)
    for name, (clock, source) in SOURCES.items():
        (CONFIGS / f"{name}.toml").write_text(RIG.format(name=name, clock=clock) + source)


def rows(query: str, *values: object) -> list[tuple[object, ...]]:
    if not DB.exists():
        return []
    with closing(sqlite3.connect(f"file:{DB}?mode=ro", uri=True)) as connection:
        try:
            return connection.execute(query, values).fetchall()
        except sqlite3.OperationalError:
            return []  # it is being made


def flows(since_ns: int = 0) -> list[str]:
    """Return the rigs of which rows have come since then."""
    found = rows(
        "SELECT rig FROM v_estimates WHERE t_ns > ? GROUP BY rig HAVING count(*) > 4 ORDER BY rig", since_ns
    )
    return [str(rig) for (rig,) in found]


def as_user(groups: list[str]) -> dict[str, bool]:
    """Tell what somebody of some groups can do: read the database, write beside it, command the agent."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.setgroups([grp.getgrnam(name).gr_gid for name in groups])
        os.setgid(pwd.getpwnam("nobody").pw_gid)
        os.setuid(pwd.getpwnam("nobody").pw_uid)
        tries = {
            "read": lambda: DB.open("rb").close(),
            "write": lambda: DB.open("r+b").close(),
            "command": command,
        }
        os.write(writing, json.dumps({name: succeeds(act) for name, act in tries.items()}).encode())
        os._exit(0)
    os.waitpid(child, 0)
    return dict(json.loads(os.read(reading, 4096)))


def succeeds(act: Callable[[], object]) -> bool:
    try:
        act()
    except PermissionError:
        return False
    return True


def command() -> dict[str, object]:
    """Ask the agent for its status, by nothing but a socket."""
    with socket.socket(socket.AF_UNIX) as peer:
        peer.connect(f"{DB}.sock")
        peer.sendall(b'{"command": "status"}\n')
        return dict(json.loads(peer.makefile().readline() or "{}"))


def asked(
    method: str, path: str, body: object = None, headers: dict[str, str] | None = None
) -> tuple[int, str, str]:
    """Ask the page; return status, cookie and what it says. Status 0 while nobody listens."""
    peer = http.client.HTTPConnection("127.0.0.1", 8765, timeout=60)
    sent = {"Content-Type": "application/json", **(headers or {})}
    try:
        peer.request(method, f"/api/v1/{path}", None if body is None else json.dumps(body), sent)
        answer = peer.getresponse()
        return answer.status, (answer.getheader("set-cookie") or "").partition(";")[0], answer.read().decode()
    except ConnectionRefusedError:
        return 0, "", ""
    finally:
        peer.close()


def use_page() -> dict[str, object]:
    """Read the page's API, sign in by a token, and have the agent refuse an alarm."""
    systemctl("start", "deltak-page")
    until(lambda: asked("GET", "latest")[0] == 200, "the page")
    rigs = {row["rig"] for row in json.loads(asked("GET", "latest")[2])["rows"]}
    status, cookie, said = asked("POST", "session", {"name": "anna", "password": TOKEN})
    headers = {"Cookie": cookie, "X-CSRF-Token": json.loads(said)["csrf"]}
    refused = asked("POST", "alarms/deltak/99999/ack", {}, headers)
    user = systemctl("show", "deltak-page", "--property=User", "--value").strip()
    systemctl("stop", "deltak-page")
    return {"rigs": sorted(rigs), "signed in": status, "refused": [refused[0], "no such alarm" in refused[2]],
            "user": user}  # fmt: skip


def greets() -> bool:
    """Tell whether the OPC UA server answers Hello with Acknowledge (Part 6, 7.1.2)."""
    url = b"opc.tcp://127.0.0.1:4840/deltak/"
    body = struct.pack("<5II", 0, 65536, 65536, 0, 0, len(url)) + url
    try:
        with socket.create_connection(("127.0.0.1", 4840), timeout=30) as peer:
            peer.sendall(b"HELF" + struct.pack("<I", 8 + len(body)) + body)
            return peer.recv(8)[:4] == b"ACKF"
    except ConnectionError:
        return False


def use_opcua() -> bool:
    """Start the OPC UA server and be greeted by it."""
    systemctl("start", "deltak-opcua")
    until(greets, "a greeting over OPC UA")
    systemctl("stop", "deltak-opcua")
    return True


def live(found: dict[str, object]) -> None:
    """Go through it all and note what is found."""
    begun = time.monotonic()
    systemctl("start", "--no-block", "deltak")
    until(lambda: shown("MainPID") != "0", "its process")
    first = shown("MainPID")
    systemctl("reload", "deltak", check=False)  # while it imports, before it can take a signal
    systemctl("start", "deltak")  # returns when READY=1 has come
    found["ready_s"] = time.monotonic() - begun
    found["survives an early reload"] = [shown("MainPID") == first, shown("NRestarts")]
    found["socket at ready"] = Path(f"{DB}.sock").exists()
    until(lambda: len(flows()) == 3, "rows of all three buses")
    found["flows"] = flows()
    found["status"] = shown("StatusText")
    found["state"] = [shown("ActiveState"), shown("NRestarts"), shown("User"), shown("Type")]
    found["limits"] = [shown("LimitCORE"), shown("LimitCORESoft"), shown("TasksMax")]
    found["reader"], found["commander"] = as_user(["deltak"]), as_user(["deltak", "deltak-command"])

    found["page"] = use_page()
    found["opcua"] = use_opcua()
    text = (CONFIGS / "plc.toml").read_text()
    (CONFIGS / "plc.toml").write_text(text.replace("noise_sd = 1e-3", "noise_sd = 2e-3"))
    systemctl("reload", "deltak")
    until(lambda: rows("SELECT 1 FROM v_events WHERE cause = 'reloaded' AND rig = 'plc'"), "the reload")
    found["runs"] = rows("SELECT rig, count(*) FROM v_runs GROUP BY rig ORDER BY rig")

    HANG.touch()
    found["killed_s"] = until(ended_by_watchdog, "an end by the watchdog")
    until(lambda: not shown("SubState").startswith(("stop", "final")), "an end of all its processes")
    found["after hang"] = shown("SubState")
    found["log"] = Path("/run/deltak.log").read_text()
    if WHOLE:
        HANG.unlink()
        again = time.time_ns()
        # a pty stays reserved for its first reader for as long as it is there, which a port does not
        until(lambda: {"can", "plc"} <= set(flows(again)), "rows after the restart")
        found["restarts"] = shown("NRestarts")
    begun = time.monotonic()
    systemctl("stop", "deltak")
    found["stop_s"] = time.monotonic() - begun
    found["after stop"] = shown("ActiveState")


@contextmanager
def playing() -> Iterator[None]:
    """Have the three devices there."""
    number = str(grp.getgrnam("dialout").gr_gid)
    command = [sys.executable, HERE / "player.py", "vcan0", "/run/deltak-line", number]
    with subprocess.Popen(command) as player:
        try:
            yield
        finally:
            player.kill()


def main(results: Path) -> None:
    install()
    systemctl("daemon-reload")
    found: dict[str, object] = {"watchdog_s": WATCHDOG_S}
    with playing():
        try:
            live(found)
        finally:
            sys.stdout.write(f"{found}\n")
            (results / "found.json").write_text(json.dumps(found))


if __name__ == "__main__":
    main(Path(os.environ["RESULTS"]))
