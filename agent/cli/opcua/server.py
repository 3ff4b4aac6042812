"""The server: endpoints, certificate and rules of the asyncua library, and what follows the databases."""

import asyncio
import signal
import sys
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from asyncua import Server, ua
from asyncua.crypto.security_policies import SecurityPolicyFactory, SecurityPolicyNone

from agent import __version__
from agent.cli.glance.files import Watched
from agent.cli.opcua.access import Options, Rules, UserDirectory, Users, read_trusted
from agent.cli.opcua.commands import Commands
from agent.cli.opcua.conditions import Conditions
from agent.cli.opcua.following import Following
from agent.cli.opcua.space import NAMESPACE, Space
from agent.cli.tuning import OPCUA_BYTES, OPCUA_SESSIONS
from agent.errors import UsageError

APPLICATION_URI: Final = "urn:deltak:server"
_REFRESH_SEVERITY: Final = 100  # fixed by OPC UA part 9: of the events around a refresh


async def until_stopped(watched: Sequence[Watched], options: Options, users: Users) -> None:
    """Serve databases until SIGINT or SIGTERM."""
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
    trusted = None if options.trusted is None else read_trusted(options.trusted)
    server = DiscoverableServer(user_manager=UserDirectory(users, trusted))
    server.iserver.bind_condition_methods = _REFRESH_SEVERITY
    await server.init()
    server.iserver.isession.max_connections = OPCUA_SESSIONS
    server.limits.max_message_size = OPCUA_BYTES
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
    plain = [ua.SecurityPolicyType.NoSecurity] if options.is_local else []
    if options.certificate is None or options.key is None:
        return plain
    await load_certificate(server, options.certificate, options.key, APPLICATION_URI)
    if options.trusted is not None:
        plain = []  # who has no certificate is not trusted
    return [
        *plain, ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
        ua.SecurityPolicyType.Aes128Sha256RsaOaep_SignAndEncrypt,
        ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
    ]  # fmt: skip


class DiscoverableServer(Server):  # type: ignore[misc] # the library is not followed by the type checker
    """A server whose endpoints can be asked for unencrypted, where nothing else can be (Part 4, 5.4)."""

    async def _setup_server_nodes(self) -> None:
        await super()._setup_server_nodes()
        if ua.SecurityPolicyType.NoSecurity not in self._security_policy:
            self._policies.append(
                SecurityPolicyFactory(
                    SecurityPolicyNone, ua.MessageSecurityMode.None_, permission_ruleset=Rules(allowed=())
                )
            )


async def load_certificate(server: Any, certificate: Path, key: Path, uri: str) -> None:
    """Give a server its certificate and key (PEM or DER) and its application's URI. Raises UsageError."""
    try:
        await server.load_certificate(certificate)
        await server.load_private_key(key)
        await server.set_application_uri(_uri(server.iserver.certificate) or uri)
    except (OSError, ValueError, TypeError, ua.UaError) as error:
        advice = "name a certificate and its key in PEM or DER"
        raise UsageError.at("--certificate", f"cannot be used ({error})", advice) from error


def _uri(certificate: Any) -> str | None:
    """Return the application's URI that a certificate is made out to; clients compare the two."""
    from cryptography import x509

    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return None
    return next(iter(names.get_values_for_type(x509.UniformResourceIdentifier)), None)
