"""Who may do what: users in a file with their password hashes, and who makes the request that is answered."""

import ipaddress
import os
import re
import sys
from collections.abc import Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from agent.cli.web.secret import Secret, asked_password, check_closed, closed_content, write_closed
from agent.cli.web.sessions import Attempts
from agent.clock import wall_ns
from agent.errors import UsageError

_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@-]{0,63}")
_NOBODY: Final = Secret.of_password("nobody has this one")
caller: ContextVar[str | None] = ContextVar("caller", default=None)
"""The user that signed in to the session whose request is being answered; None for whoever did not."""

Users = Mapping[str, Secret]


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


def read_users(path: Path) -> Users:
    """Return the users of a file, `NAME:HASH` a line. Raises UsageError for one that cannot be used."""
    found: dict[str, Secret] = {}
    for number, line in enumerate(closed_content(path).splitlines(), 1):
        name, _, content = line.strip().partition(":")
        secret = Secret.read(content)
        if _NAME.fullmatch(name) is None or secret is None:
            advice = f"write it with `deltak opcua --users {path} --new-user NAME`"
            raise UsageError.at(f"{path}:{number}", "is no user with the hash of a password", advice)
        found[name] = secret
    if not found:
        raise UsageError.at(path, "holds no user", f"deltak opcua --users {path} --new-user NAME")
    return found


def read_trusted(folder: Path) -> Mapping[bytes, int]:
    """Return the certificates of a folder (PEM or DER): each as DER, with the second at which it ends.

    Raises UsageError for a folder that cannot be read or holds none, and for files that are no certificates.
    """
    from cryptography import x509
    from cryptography.hazmat.primitives.serialization import Encoding

    found: dict[bytes, int] = {}
    try:
        for file in sorted(folder.iterdir()):
            data = file.read_bytes()
            is_text = data.lstrip().startswith(b"-----")
            one = x509.load_pem_x509_certificate(data) if is_text else x509.load_der_x509_certificate(data)
            found[one.public_bytes(Encoding.DER)] = int(one.not_valid_after_utc.timestamp())
    except (OSError, ValueError) as error:
        advice = "name a folder with nothing but certificates of clients, in PEM or DER"
        raise UsageError.at("--trusted", f"cannot be used ({error})", advice) from error
    if not found:
        raise UsageError.at("--trusted", f"{folder} holds no certificate", "put those of the clients there")
    return found


def add_user(path: Path | None, name: str) -> None:
    """Ask for a user's password, twice on a terminal; add it to the file or replace it. Raises UsageError."""
    if path is None:
        raise UsageError.at("--new-user", "needs --users", "name the file that it is added to")
    if _NAME.fullmatch(name) is None:
        raise UsageError.at("--new-user", f"{name!r} is no name", "take letters, digits, . _ @ -, at most 64")
    password = asked_password()
    users = dict(read_users(path)) if path.exists() else {}
    users[name] = Secret.of_password(password)
    write_closed(path, "".join(f"{user}:{secret.line()}\n" for user, secret in users.items()))
    sys.stdout.write(f"wrote {path}; start with --users {path}\n")


class UserDirectory:
    """The user manager of the server: a user by name and password, or nobody in particular.

    Args:
        users: by name. Five wrong passwords of a name within a minute, and that name has to wait.
        trusted: certificates that a client's channel must have one of (see `read_trusted`); None for any.
    """

    def __init__(self, users: Users, trusted: Mapping[bytes, int] | None = None) -> None:
        self._users, self._trusted = users, trusted
        self._attempts = Attempts()

    def get_user(
        self, _server: Any, username: str | None = None, password: str | None = None, certificate: Any = None
    ) -> Any:
        """Return who signs in; None where that is refused."""
        from asyncua.server.user_managers import User, UserRole

        if self._trusted is not None and self._trusted.get(certificate or b"", 0) * 10**9 < wall_ns():
            return None
        if username is None:
            return User(role=UserRole.Anonymous)
        if not self._is_known(username, password or ""):
            return None
        return User(role=UserRole.User, name=username)

    def _is_known(self, name: str, password: str) -> bool:
        secret = self._users.get(name)
        if self._attempts.wait_s(name) > 0.0:
            return False
        known = (secret or _NOBODY).is_known_by(
            password
        ) and secret is not None  # as long for a name nobody has
        if not known:
            self._attempts.fail(name)
        return known


class Rules:
    """What sessions may ask: reading and subscribing all, methods those who are signed in, writing nobody.

    Methods are asked by everybody, since refreshing conditions is one; those that command ask for a `caller`.
    """

    def __init__(self, allowed: tuple[str, ...] | None = None) -> None:
        from asyncua import ua

        names = _ALLOWED if allowed is None else allowed
        self._allowed = frozenset(
            ua.NodeId(getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary")) for name in names
        )

    def check_validity(self, user: Any, action: Any, _body: Any) -> bool:
        """Tell whether a request may be answered, and note who makes it."""
        caller.set(getattr(user, "name", None))
        return action in self._allowed


_ALLOWED: Final = (
    "CreateSession", "CloseSession", "ActivateSession", "CloseSecureChannel", "GetEndpoints", "FindServers",
    "Read", "Browse", "TranslateBrowsePathsToNodeIds", "CreateSubscription", "ModifySubscription",
    "DeleteSubscriptions", "CreateMonitoredItems", "ModifyMonitoredItems", "DeleteMonitoredItems", "Publish",
    "Republish", "Call", "SetMonitoringMode", "SetPublishingMode", "RegisterNodes", "UnregisterNodes",
)  # fmt: skip


def check_key(path: Path) -> None:
    """Raise UsageError where a private key may be read by others."""
    try:
        mode = os.stat(path).st_mode  # noqa: PTH116 - a link is followed, as the key is read
    except OSError as error:
        raise UsageError.at(path, f"cannot be read ({error})", "name the file of a private key") from error
    check_closed(path, mode)


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
