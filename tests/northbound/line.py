"""A line to a server that can be cut and frozen, and servers that are started for a test."""

import contextlib
import os
import select
import shutil
import signal
import socket
import stat
import subprocess
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from agent.northbound.forwarder import Forwarder
from agent.storage.write.writer import StoreWriter
from tests.peers import program
from tests.ports import free_port
from tests.scenario.live import wait_until
from tests.storage.rows import batch


class Line:
    """Carries bytes between whoever connects to `port` and a server; `cut` ends what is connected.

    Attributes:
        budget: bytes that the server still gets before the line breaks; None for all.
        freezes: whether it then carries nothing any more, instead of being cut.
    """

    def __init__(self, to: int) -> None:
        self._to = to
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self.budget: int | None = None
        self.freezes = False
        self.down = False
        self.cuts = 0
        self._flows = threading.Event()
        self._flows.set()
        self._pairs: list[tuple[socket.socket, socket.socket]] = []
        self._over = False
        self._thread = threading.Thread(target=self._accept, daemon=True)
        self._thread.start()

    def _accept(self) -> None:
        while not self._over:
            try:
                near, _ = self._server.accept()
                far = socket.create_connection(("127.0.0.1", self._to), 5)
            except OSError:
                with contextlib.suppress(UnboundLocalError):
                    near.close()
                continue
            if self.down:
                near.close()
                far.close()
                continue
            self._pairs.append((near, far))
            threading.Thread(target=self._carry, args=(near, far), daemon=True).start()

    def _carry(self, near: socket.socket, far: socket.socket) -> None:
        other = {near: far, far: near}
        try:
            while True:
                ready, _, _ = select.select([near, far], [], [])
                self._flows.wait()
                if (near, far) not in self._pairs:  # cut while nothing flowed: what it holds is lost
                    return
                for one in ready:
                    data = one.recv(65536)
                    if not data:
                        return
                    other[one].sendall(data if one is far else self._paid(data))
        except (OSError, ValueError):
            pass
        finally:
            near.close()
            far.close()

    def _paid(self, data: bytes) -> bytes:
        """Return what of some bytes the budget is enough for; break where it is not."""
        if self.budget is None or len(data) < self.budget:
            self.budget = None if self.budget is None else self.budget - len(data)
            return data
        data, self.budget = data[: self.budget], None
        if self.freezes:
            self._flows.clear()
        else:
            self.cut()
        return data

    def freeze(self) -> None:
        """Carry nothing until it is mended."""
        self._flows.clear()

    def mend(self) -> None:
        """Carry what comes, on connections that are made from now on."""
        if not self._flows.is_set():
            self.cut()
        self._flows.set()

    def cut(self) -> None:
        self.cuts += 1
        pairs, self._pairs = self._pairs, []
        for pair in pairs:
            for one in pair:
                with contextlib.suppress(OSError):
                    one.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._over = True
        self.cut()
        self._flows.set()
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()


def disturb(line: Line, writer: StoreWriter, forwarder: Forwarder, rows: int, breaks: int) -> None:
    """Store instants while the line breaks amid what it carries: cut, and each third time frozen."""
    share = rows // breaks
    for number in range(breaks):
        before = forwarder.retries
        line.freezes, line.budget = number % 3 == 2, 1500 * (number + 1)
        writer.publish([batch(share, first=share * number)])
        wait_until(lambda n=before: forwarder.retries > n, f"break {number} to be noticed", 20)
        line.mend()
    writer.flush()


@contextmanager
def line_to(port: int) -> Iterator[Line]:
    line = Line(port)
    try:
        yield line
    finally:
        line.close()


class Server:
    """A server in processes of its own, which can be killed, frozen and started again on its port.

    Args:
        port: where it listens.
        command, settings: how it is started; settings are those of Popen.
        asking: a command that succeeds once it takes requests, where that is later than that it listens.
    """

    def __init__(
        self, port: int, command: Sequence[str | Path], asking: Sequence[str] = ("true",), **settings: Any
    ) -> None:
        self.port = port
        self._command, self._settings, self._asking = command, settings, asking
        self.start()

    def start(self) -> None:
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
        self._process = subprocess.Popen(self._command, **quiet, **self._settings)
        wait_for_port(self.port)
        wait_until(
            lambda: subprocess.run(self._asking, check=False).returncode == 0, "it to take requests", 20
        )

    def send(self, number: signal.Signals) -> None:
        """Send a signal to all its processes, as systemd does to those of a unit."""
        for process in [self._process.pid, *_children(self._process.pid)]:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, number)

    def kill(self) -> None:
        """End it as the kernel does that lacks memory."""
        self.send(signal.SIGKILL)
        self._process.wait()

    def close(self, number: signal.Signals = signal.SIGKILL) -> None:
        self.send(number)
        self.send(signal.SIGCONT)
        self._process.wait()


def _children(parent: int) -> list[int]:
    """Return the processes below one; those of PostgreSQL are each a session of its own."""
    try:
        found = Path(f"/proc/{parent}/task/{parent}/children").read_text(encoding="ascii").split()
    except (FileNotFoundError, ProcessLookupError):  # it has ended since it was listed
        return []
    return [process for child in map(int, found) for process in (child, *_children(child))]


@contextmanager
def broker(folder: Path, settings: str = "allow_anonymous true") -> Iterator[Server]:
    """Run mosquitto on loopback; settings: lines of its configuration."""
    path, port = program("mosquitto", "mosquitto"), free_port()
    file = folder / f"mosquitto-{port}.conf"
    file.write_text(
        f"user root\nlistener {port} 127.0.0.1\nmax_queued_messages 0\n{settings}\n", encoding="utf-8"
    )
    server = Server(port, [path, "-c", file])
    try:
        yield server
    finally:
        server.close()


@contextmanager
def mosquitto(folder: Path, settings: str = "allow_anonymous true") -> Iterator[int]:
    """As `broker`, of which only the port matters."""
    with broker(folder, settings) as server:
        yield server.port


def _let_pass(folder: Path) -> None:
    """Let others through to a folder; whatever else may be done on the way stays as it is."""
    for one in (folder, *folder.parents):
        mode = stat.S_IMODE(one.stat().st_mode)
        if not mode & stat.S_IXOTH:
            one.chmod(mode | stat.S_IXOTH | stat.S_IROTH)


@contextmanager
def database(folder: Path, password: str | None = None) -> Iterator[Server]:
    """Run PostgreSQL on loopback, as nobody where the tests are root; its superuser is `deltak`."""
    places = ":".join(sorted(str(found) for found in Path("/usr/lib/postgresql").glob("*/bin")))
    os.environ["PATH"] = f"{os.environ['PATH']}:{places}"
    initdb, postmaster = program("initdb", "postgresql"), program("postgres", "postgresql")
    port, home = free_port(), folder / "postgres"
    home.mkdir()
    _let_pass(folder)
    word = home / "word"
    word.write_text(password or "none", encoding="utf-8")
    if os.getuid() == 0:
        for one in (home, word):
            shutil.chown(one, "nobody", "nogroup")
    user = {"user": "nobody", "group": "nogroup", "extra_groups": []} if os.getuid() == 0 else {}
    way = "scram-sha-256" if password else "trust"
    subprocess.run([initdb, "-D", home / "data", "-U", "deltak", "-A", way, "--pwfile", word, "-N", "-E",
                    "UTF8"], check=True, capture_output=True, cwd=home, **user)  # fmt: skip
    command = [postmaster, "-D", home / "data", "-p", str(port), "-k", home, "-h", "127.0.0.1", "-F", "-c",
               "shared_buffers=1MB", "-c", "logging_collector=off"]  # fmt: skip
    asking = [program("pg_isready", "postgresql"), "-q", "-h", "127.0.0.1", "-p", str(port)]
    server = Server(port, command, asking, cwd=home, **user)
    try:
        yield server
    finally:
        server.close(signal.SIGQUIT)


@contextmanager
def postgres(folder: Path, password: str | None = None) -> Iterator[int]:
    """As `database`, of which only the port matters."""
    with database(folder, password) as server:
        yield server.port


def wait_for_port(port: int, limit_s: float = 20) -> None:
    wait_until(lambda: _listens(port), f"somebody to listen on port {port}", limit_s)


def _listens(port: int) -> bool:
    try:
        with socket.create_connection(("127.0.0.1", port), 1):
            return True
    except OSError:
        return False


_CA = """[ca]
default_ca = d
[d]
database = {folder}/index
new_certs_dir = {folder}
serial = {folder}/serial
default_md = sha256
policy = p
copy_extensions = copy
[p]
commonName = supplied
[req]
distinguished_name = n
[n]
"""


def certificates(folder: Path) -> None:
    """Make ca.pem, and certificates with keys of that authority: server, client, expired."""
    openssl = program("openssl", "openssl")

    def run(*words: str) -> None:
        subprocess.run([openssl, *words], check=True, capture_output=True, cwd=folder)

    (folder / "ca.cnf").write_text(_CA.format(folder=folder), encoding="utf-8")
    (folder / "index").touch()
    (folder / "serial").write_text("01\n", encoding="utf-8")
    key = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-config", "ca.cnf")
    run(
        "req",
        "-x509",
        *key,
        "-keyout",
        "ca.key",
        "-out",
        "ca.pem",
        "-subj",
        "/CN=test authority",
        "-days",
        "9",
    )
    spans = {"server": ("240101000000Z", "490101000000Z"), "expired": ("240101000000Z", "240102000000Z")}
    for name in ("server", "client", "expired"):
        alternative = ("-addext", "subjectAltName=IP:127.0.0.1")
        run(
            "req", *key, "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj", f"/CN={name}", *alternative
        )
        first, last = spans.get(name, spans["server"])
        run("ca", "-batch", "-config", "ca.cnf", "-cert", "ca.pem", "-keyfile", "ca.key",
            "-in", f"{name}.csr", "-out", f"{name}.pem",
            "-notext", "-startdate", first, "-enddate", last)  # fmt: skip
    shutil.copy(folder / "ca.pem", folder / "ca-copy.pem")
