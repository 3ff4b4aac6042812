"""`deltak opcua`: options to settings, and the server that runs until it is stopped."""

import asyncio
import ipaddress
import logging
import signal
import sys
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from agent import __version__
from agent.cli.glance.files import Watched, several
from agent.cli.opcua.access import Rules, UserDirectory, Users, add_user, check_key, read_trusted, read_users
from agent.cli.opcua.commands import Commands
from agent.cli.opcua.conditions import Conditions
from agent.cli.opcua.following import Following
from agent.cli.opcua.space import NAMESPACE, Space
from agent.errors import UsageError
from agent.storage.read import queries

__all__ = ["Options", "add_user", "serve"]
APPLICATION_URI: Final = "urn:deltak:server"
_MOST_SESSIONS: Final = 100
_MOST_MESSAGE: Final = 1024 * 1024  # bytes of one; the library's own bound is a hundred times that
_REFRESH_SEVERITY: Final = 100


@dataclass(frozen=True, slots=True)
class Options:
    """What the command line says, but for the databases."""

    host: str = "127.0.0.1"
    port: int = 4840
    hostname: str | None = None
    users: Path | None = None
    certificate: Path | None = None
    key: Path | None = None
    trusted: Path | None = None
    private: bool = False

    def address(self, port: int) -> str:
        """Return the URL under which clients reach it."""
        host = self.hostname or (f"[{self.host}]" if ":" in self.host else self.host)
        return f"opc.tcp://{host}:{port}/deltak/"

    @property
    def is_local(self) -> bool:
        """Whether nobody but this machine can reach it."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"


def serve(targets: Sequence[Path], options: Options) -> None:
    """Answer OPC UA clients until SIGINT or SIGTERM.

    Raises:
        UsageError: without the extra `opcua`, for an address that needs users and a certificate, or one that
            cannot be used; ConfigError, StoreError: a configuration or a database that cannot be read.
    """
    try:
        import asyncua
    except ImportError as error:
        raise UsageError.at(
            "opcua", f"needs the extra opcua ({error})", "pip install 'deltak[opcua]'"
        ) from error
    del asyncua
    if not logging.getLogger().isEnabledFor(
        logging.INFO
    ):  # what clients do wrong is answered to them, not logged
        logging.getLogger("asyncua").setLevel(logging.CRITICAL)
    watched = _watched(targets)
    users = read_users(options.users) if options.users is not None else {}
    check(options, users)
    asyncio.run(_until_stopped(watched, options, users))


def check(options: Options, users: Users) -> None:
    """Raise UsageError for options that do not go together or would leave the server open to others."""
    if (options.certificate is None) != (options.key is None):
        raise UsageError.at("--certificate", "needs --key, and --key needs it", "give both")
    if options.key is not None:
        check_key(options.key)
    if options.trusted is not None and options.certificate is None:
        raise UsageError.at(
            "--trusted", "needs --certificate", "clients show theirs where the server has one"
        )
    if options.private and not users:
        raise UsageError.at("--private", "needs users", "give --users FILE")
    if not options.is_local and not (users and options.certificate is not None):
        what = f"others can reach {options.host}, and there are no users or no certificate"
        raise UsageError.at("--host", what, "give --users, --certificate and --key")


async def _until_stopped(watched: Sequence[Watched], options: Options, users: Users) -> None:
    stop = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, stop.set)
    async with running(watched, options, users) as address:
        sys.stdout.write(f"serving {', '.join(database.name for database in watched)} on {address}\n")
        sys.stdout.flush()
        await stop.wait()


@asynccontextmanager
async def running(watched: Sequence[Watched], options: Options, users: Users) -> AsyncIterator[str]:
    """Have a server that follows databases; yields its address. Raises UsageError where it cannot be made."""
    server = await _made(options, users)
    space = Space(server, await server.register_namespace(NAMESPACE))
    conditions = Conditions(space)
    following = Following(watched, space, conditions)
    commands = Commands(
        conditions, {database.name: database.path for database in watched}, following.news.set
    )
    conditions.methods = commands.methods()
    commands.link(server)
    await following.look()
    try:
        await server.start()
    except OSError as error:
        what = f"{options.host} port {options.port} cannot be used ({error})"
        raise UsageError.at("--host", what, "take others") from error
    task = asyncio.create_task(following.run())
    try:
        yield options.address(server.bserver.port)
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        await server.stop()


async def _made(options: Options, users: Users) -> Any:
    """Return the server, set up and not started."""
    from asyncua import ua

    from agent.cli.opcua.library import DiscoverableServer

    trusted = None if options.trusted is None else read_trusted(options.trusted)
    server = DiscoverableServer(user_manager=UserDirectory(users, trusted))
    server.iserver.bind_condition_methods = _REFRESH_SEVERITY
    await server.init()
    server.iserver.isession.max_connections = _MOST_SESSIONS
    server.limits.max_message_size = _MOST_MESSAGE
    server.set_server_name("deltak")
    await server.set_build_info(
        APPLICATION_URI, "deltak", "deltak", __version__, __version__, datetime.now(UTC)
    )
    server.socket_address = (options.host, options.port)
    server.set_endpoint(options.address(options.port))
    anybody = [ua.AnonymousIdentityToken] if options.is_local and not options.private else []
    somebody = [ua.UserNameIdentityToken] if users else []
    server.set_identity_tokens([*anybody, *somebody])
    server.set_security_policy(await _policies(server, options), Rules())
    return server


async def _policies(server: Any, options: Options) -> list[Any]:
    """Return the security policies; with a certificate encrypting ones, on this machine alone also none."""
    from asyncua import ua

    plain = [ua.SecurityPolicyType.NoSecurity] if options.is_local else []
    if options.certificate is None or options.key is None:
        return plain
    from agent.cli.opcua.library import load_certificate

    await load_certificate(server, options.certificate, options.key, APPLICATION_URI)
    if options.trusted is not None:
        plain = []  # who has no certificate is not trusted
    return [
        *plain, ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
        ua.SecurityPolicyType.Aes128Sha256RsaOaep_SignAndEncrypt,
        ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
    ]  # fmt: skip


def _watched(targets: Sequence[Path]) -> list[Watched]:
    """Return the databases named, or named by configurations. Raises UsageError, ConfigError, StoreError."""
    if not targets:
        raise UsageError.at("opcua", "no database is named", "give databases or configurations")
    databases = [target for target in targets if not (target.suffix == ".toml" or target.is_dir())]
    found = several(databases, [target for target in targets if target not in databases])
    for database in found:
        queries.rigs(database.path)  # says at once what is wrong with it
    return found
