"""The password or token that opens a session: kept in a file, a password as its scrypt hash (RFC 7914)."""

import base64
import getpass
import hashlib
import hmac
import os
import stat
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from agent.cli.tuning import PASSWORD_BYTES, PASSWORD_COST, SECRET_BYTES, SECRET_FILE_BYTES, TOKEN_BYTES
from agent.errors import UsageError

_GROUP, _OTHERS = 0o070, 0o007  # fixed by POSIX: rights of the group and of others


@dataclass(frozen=True, slots=True)
class Secret:
    """What somebody must know who is to acknowledge; exactly one of the two.

    Attributes:
        password: salt and hash, both bytes; token: as it is.
    """

    password: tuple[bytes, bytes] | None = None
    token: bytes | None = None

    def is_known_by(self, text: str) -> bool:
        """Tell whether a text is the password or the token; takes equally long for right and wrong ones."""
        said = text.encode("utf-8", "replace")[:SECRET_BYTES]
        if self.password is not None:
            salt, known = self.password
            return hmac.compare_digest(_hash(said, salt), known)
        return self.token is not None and hmac.compare_digest(said, self.token)

    @classmethod
    def of_password(cls, text: str) -> Self:
        """Return the secret of a new password. Raises UsageError for one that is too short or too long."""
        said = text.encode()
        if not PASSWORD_BYTES <= len(said) <= SECRET_BYTES:
            raise UsageError.at(
                "password", f"has {len(said)} bytes", f"take {PASSWORD_BYTES} to {SECRET_BYTES}"
            )
        salt = os.urandom(16)
        return cls(password=(salt, _hash(said, salt)))

    @classmethod
    def read(cls, line: str) -> Self | None:
        """Return the secret whose `line` this is; None where it is none."""
        parts = line.split(":")
        if parts[:4] != ["scrypt", *map(str, PASSWORD_COST)] or len(parts) != 6:
            return None
        try:
            salt, known = (base64.b64decode(part, validate=True) for part in parts[4:])
        except ValueError:
            return None
        return cls(password=(salt, known))

    def line(self) -> str:
        """Return a password's hash as a file holds it."""
        parts = [base64.b64encode(part).decode() for part in self.password or ()]
        return ":".join(["scrypt", *map(str, PASSWORD_COST), *parts])


def from_files(password: Path | None, token: Path | None) -> Secret | None:
    """Return the secret a file holds; None without one. Raises UsageError for an unusable file."""
    if password is not None and token is not None:
        raise UsageError.at("--token-file", "cannot go with --password-file", "give one of them")
    if password is not None:
        return _password(password)
    return None if token is None else _token(token)


def asked_password() -> str:
    """Ask for a new password, twice on a terminal. Raises UsageError where the two differ."""
    if not sys.stdin.isatty():
        return sys.stdin.readline().rstrip("\n")
    first, second = getpass.getpass("password: "), getpass.getpass("once more: ")
    if first != second:
        raise UsageError.at("password", "was not the same twice", "try again")
    return first


def write_password(path: Path, text: str) -> None:
    """Write a password's hash to a file only its owner can read. Raises UsageError where that cannot be."""
    write_closed(path, f"{Secret.of_password(text).line()}\n")


def write_closed(path: Path, content: str) -> None:
    """Write a file that only its owner can read. Raises UsageError where that cannot be."""
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o600)
        with os.fdopen(handle, "w", encoding="ascii") as file:
            os.fchmod(file.fileno(), 0o600)
            file.write(content)
    except OSError as error:
        raise UsageError.at(
            path, f"cannot be written ({error})", "name a file that can be written"
        ) from error


def _hash(text: bytes, salt: bytes) -> bytes:
    n, r, p = PASSWORD_COST
    return hashlib.scrypt(text, salt=salt, n=n, r=r, p=p, maxmem=64 * 1024 * 1024)


def closed_content(path: Path) -> str:
    """Return what a secrets file holds. Raises UsageError where it cannot be read, or others can read it."""
    try:
        with path.open(encoding="utf-8") as file:
            mode = stat.S_IMODE(os.fstat(file.fileno()).st_mode)
            content = file.read(SECRET_FILE_BYTES).strip()
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError.at(
            path, f"cannot be read ({error})", "name a file with a password or a token"
        ) from error
    check_closed(path, mode)
    return content


def check_closed(path: Path, mode: int) -> None:
    """Raise UsageError where others may use a file.

    Of a file that systemd made for this service a group's rights are passed over: its access list stands
    there.
    """
    folder = os.environ.get("CREDENTIALS_DIRECTORY")
    is_handed_over = folder is not None and path.parent == Path(folder)
    if mode & (_OTHERS if is_handed_over else _OTHERS | _GROUP):
        raise UsageError.at(path, f"may be used by others (mode {mode & 0o7777:04o})", f"chmod 600 {path}")


def _password(path: Path) -> Secret:
    secret = Secret.read(closed_content(path))
    if secret is None:
        advice = f"make it with `deltak serve --new-password {path}`"
        raise UsageError.at(path, "holds no hash of a password", advice)
    return secret


def _token(path: Path) -> Secret:
    content = closed_content(path)
    if len(content) < TOKEN_BYTES:
        what = f"holds a token of {len(content)} characters"
        raise UsageError.at(path, what, f"take at least {TOKEN_BYTES}, such as `openssl rand -hex 32`")
    return Secret(token=content.encode())
