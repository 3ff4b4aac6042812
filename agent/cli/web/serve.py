"""`deltak serve`: options to settings, and the server that runs until it is stopped."""

import ipaddress
import socket
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from agent.cli.glance.files import Watched, several
from agent.cli.tuning import WEB_STOP_S
from agent.cli.web.secret import Secret, asked_password, from_files, write_password
from agent.errors import UsageError
from agent.storage.read import queries

LOCAL: Final = frozenset({"localhost", "127.0.0.1", "[::1]"})


@dataclass(frozen=True, slots=True)
class Options:
    """What the command line says, but for the databases."""

    host: str
    port: int
    password_file: Path | None = None
    token_file: Path | None = None
    private: bool = False
    hostnames: Sequence[str] = ()
    proxy: str | None = None


def serve(databases: Sequence[Path], configs: Sequence[Path], options: Options) -> None:
    """Answer on HTTP until SIGINT or SIGTERM.

    Raises:
        UsageError: without the extra `web`, for an address that needs a password, or one that cannot be used;
        ConfigError, StoreError: a configuration or a database that cannot be read.
    """
    try:
        import starlette
        import uvicorn
    except ImportError as error:
        raise UsageError.at("serve", f"needs the extra web ({error})", "pip install 'deltak[web]'") from error
    del starlette
    from agent.cli.web.app import Settings, application

    watched = _watched(databases, configs)
    secret = from_files(options.password_file, options.token_file)
    _check(options, secret)
    settings = Settings(tuple(watched), secret, options.private, _hosts(options))
    with _bound(options.host, options.port) as listener:
        address = f"http://{_shown(options.host)}:{listener.getsockname()[1]}/"
        sys.stdout.write(f"serving {', '.join(database.name for database in watched)} on {address}\n")
        sys.stdout.flush()
        config = uvicorn.Config(
            application(settings), log_config=None, access_log=False, server_header=False, lifespan="on",
            timeout_graceful_shutdown=WEB_STOP_S, proxy_headers=options.proxy is not None,
            forwarded_allow_ips=options.proxy, ws="none",
        )  # fmt: skip
        uvicorn.Server(config).run([listener])


def new_password(path: Path) -> None:
    """Ask for a password, twice on a terminal, and write its hash. Raises UsageError."""
    write_password(path, asked_password())
    sys.stdout.write(f"wrote {path}; start with --password-file {path}\n")


def _watched(databases: Sequence[Path], configs: Sequence[Path]) -> list[Watched]:
    watched = several(databases, configs)
    if not watched:
        raise UsageError.at("--db", "no database is named", "give --db DB, or --config FILE")
    for database in watched:
        queries.rigs(database.path)  # says at once what is wrong with it
    return watched


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _check(options: Options, secret: Secret | None) -> None:
    if options.private and secret is None:
        raise UsageError.at(
            "--private", "needs a password or a token", "give --password-file or --token-file"
        )
    if secret is None and not (_is_loopback(options.host) and options.proxy is None):
        what = f"others can reach {options.host}" if options.proxy is None else "a proxy lets others in"
        raise UsageError.at(
            "--host", f"{what}, and there is no password", "give --password-file or --token-file"
        )


def _hosts(options: Options) -> frozenset[str] | None:
    """Return the names the server may be asked by; None for any, where it is bound to no loopback address."""
    if options.hostnames or _is_loopback(options.host):
        return LOCAL | {name.lower() for name in options.hostnames} | {_shown(options.host).lower()}
    return None


def _shown(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _bound(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family, backlog=512)
    except OSError as error:
        raise UsageError.at(
            "--host", f"{host} port {port} cannot be used ({error})", "take others"
        ) from error
