"""The files beside the database: lock, ballast, directory entries, and what kind of file lies at a path."""

import errno
import fcntl
import os
import stat
from contextlib import suppress
from enum import Enum
from pathlib import Path
from typing import BinaryIO

from agent.errors import StoreError, StoreHeldError
from agent.storage.database.schema import APPLICATION_ID, PAGE_SIZE, SCHEMA_VERSION, version_mark
from agent.storage.tuning import BALLAST_BYTES, HEAD_BYTES, READ_BYTES

_MAGIC = b"SQLite format 3\0"
_OURS_WRITTEN = b"CREATE VIEW v_estimates_windows"
_FIXED = (
    (16, PAGE_SIZE.to_bytes(2, "big") + bytes((2, 2, 0, 64, 32, 32))),
    (44, b"\0\0\0\4"),
    (56, b"\0\0\0\1"),
)
"""Header bytes of every file of ours; SQLite takes some, when wrong, for a file it may not write to."""
_COMPANIONS = ("-wal", "-shm", "-journal")  # what SQLite itself writes beside a database


class Kind(Enum):
    """What lies at a path."""

    MISSING = "missing"
    OURS = "ours"
    DAMAGED = "damaged"
    FOREIGN = "foreign"
    NEWER = "newer"


def beside(path: Path, suffix: str) -> Path:
    """Return the path of a companion file: the database's whole name and a suffix."""
    return path.with_name(path.name + suffix)


def remove_database(path: Path) -> None:
    """Remove a database and its log, the log first: one that stayed would be read into the next file."""
    for suffix in (*_COMPANIONS, ""):
        beside(path, suffix).unlink(missing_ok=True)


def opened(path: Path | str, flags: int, mode: int = 0o640) -> int:
    """Open a file to make or write, never what a symbolic link there leads to; an `opener` of `open`.

    Raises:
        OSError: errno ELOOP where there is such a link.
    """
    return os.open(path, flags | os.O_NOFOLLOW | os.O_CLOEXEC, mode)


def created(path: Path) -> BinaryIO:
    """Make a new file to write to; OSError where there is one, or a symbolic link."""
    return os.fdopen(opened(path, os.O_RDWR | os.O_CREAT | os.O_EXCL), "wb")


def refuse_links(path: Path) -> None:
    """Raise StoreError where the database, or what SQLite writes beside it, is a symbolic link."""
    for suffix in ("", *_COMPANIONS):
        file = beside(path, suffix)
        if file.is_symlink():
            advice = "give the path that it leads to" if not suffix else "remove it"
            raise StoreError.at(file, "is a symbolic link, which is not written through", advice)


def hand_over(handle: int, like: Path) -> None:
    """Give a file made by root to another's owner: what root makes beside a database the agent must open."""
    if os.geteuid() == 0:
        owner = like.stat()
        os.fchown(handle, owner.st_uid, owner.st_gid)


def make_alike(path: Path, like: Path) -> None:
    """Give a file the owner and the permissions of another one."""
    handle = opened(path, os.O_RDONLY)
    try:
        hand_over(handle, like)
        os.fchmod(handle, stat.S_IMODE(like.stat().st_mode))
    finally:
        os.close(handle)


def sync_folder(folder: Path) -> None:
    """Make renames and new names in a folder survive a power cut."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def renew(path: Path) -> None:
    """Write a file's content once more, as it is, and sync it; nothing where there is none.

    A sync that failed leaves the file's cache clean: it reads well, a later sync succeeds, and yet part of it
    is not on the disk. So a process that did not see that sync (its predecessor did, and was killed) trusts
    no log that it finds.
    """
    try:
        handle = opened(path, os.O_RDWR)
    except FileNotFoundError:
        return
    try:
        place = 0
        while block := os.pread(handle, READ_BYTES, place):
            place += os.pwrite(handle, block, place)
        os.fsync(handle)
    finally:
        os.close(handle)


def kind_of(path: Path) -> Kind:
    """Look at the first bytes; a file that was ours once and lost its marks is DAMAGED, never FOREIGN.

    An empty file counts as MISSING: nothing can be lost by making it anew.
    """
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except FileNotFoundError:
        return Kind.MISSING
    except PermissionError as error:
        raise StoreError.at(path, "permission denied", "run as a user who may read it") from error
    if not head:
        return Kind.MISSING
    application_id = int.from_bytes(head[68:72], "big")
    if head[:16] == _MAGIC and application_id == APPLICATION_ID:
        return _version_kind(head)
    return Kind.DAMAGED if _was_ours(path, head) else Kind.FOREIGN


def _version_kind(head: bytes) -> Kind:
    version = int.from_bytes(head[62:64], "big")
    if int.from_bytes(head[60:64], "big") != version_mark(version):
        return Kind.DAMAGED
    if any(head[place : place + len(fixed)] != fixed for place, fixed in _FIXED):
        return Kind.DAMAGED
    return Kind.NEWER if version > SCHEMA_VERSION else Kind.OURS


def _was_ours(path: Path, head: bytes) -> bool:
    if _OURS_WRITTEN in head:
        return True
    if head[:16] == _MAGIC and any(head[68:72]):
        return False  # a healthy header that names another application
    try:
        return beside(path, ".lock").read_bytes().startswith(_LOCK_MARK)
    except PermissionError:
        return True  # private to the agent, as its lock is
    except OSError:
        return False


def refuse(path: Path, kind: Kind) -> None:
    """Raise StoreError for files that this version must not touch."""
    if kind is Kind.FOREIGN:
        raise StoreError.at(
            path, "this file is not a deltak database", "give another path; it was not changed"
        )
    if kind is Kind.NEWER:
        advice = f"this program reads up to version {SCHEMA_VERSION}: update it; the file was not changed"
        raise StoreError.at(path, "the database was written by a newer version of deltak", advice)


def check_place(path: Path) -> None:
    """Raise StoreError when no database can lie at a path."""
    if path.is_dir():
        raise StoreError.at(path, "is a directory", "give the path of a file")
    if path.exists() and not path.is_file():  # opening a pipe may wait for ever
        raise StoreError.at(path, "is a pipe or a device", "give the path of a file")
    if not path.parent.is_dir():
        raise StoreError.at(path, f'there is no folder "{path.parent}"', "make it first")


def check_writable(path: Path) -> None:
    """Raise StoreError if permissions forbid writing a database at a path; a read-only disk may be mended."""
    folder = path.parent
    forbidden = not os.access(folder, os.W_OK | os.X_OK) and not os.statvfs(folder).f_flag & os.ST_RDONLY
    try:
        if path.exists():
            os.close(os.open(path, os.O_RDWR))
    except PermissionError:
        forbidden = True
    except OSError:
        pass  # met again, and reported, when it is opened in earnest
    if forbidden:
        advice = f"run as the owner of the file and of its folder, or let this user write to {folder}"
        raise StoreError.at(path, "permission denied", advice)


_LOCK_MARK = b"deltak "


class Lock:
    """The right to change a database: flock on DB.lock, freed by the kernel when its holder dies.

    Its descriptor, `handle`, is -1 once it is released. Raises StoreHeldError when another process holds it.
    The file stays: removing it would let two processes lock two different files of one name. Nobody but its
    owner may open it, since a lock can be held through a descriptor that may only read.

    Attributes:
        private: nobody else could have written to the file before.
    """

    def __init__(self, path: Path) -> None:
        self._file = beside(path, ".lock")
        self.handle = self._opened()
        self.private = not os.fstat(self.handle).st_mode & 0o077
        with suppress(OSError):
            os.fchmod(self.handle, 0o600)
            hand_over(self.handle, path if path.exists() else path.parent)
        try:
            fcntl.flock(self.handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = self._holder()
            os.close(self.handle)
            what = f"process {holder} is writing to this database"
            raise StoreHeldError.at(path, what, "stop it first") from error
        self._sign()

    def _opened(self) -> int:
        try:
            handle = opened(self._file, os.O_RDWR | os.O_CREAT | os.O_NONBLOCK, 0o600)
        except PermissionError as error:
            raise StoreError.at(self._file, "permission denied", "run as the owner of the folder") from error
        except OSError as error:
            if error.errno != errno.ELOOP:
                raise
            raise StoreError.at(self._file, "is a symbolic link", "remove it") from error
        if stat.S_ISREG(os.fstat(handle).st_mode):
            return handle
        os.close(handle)
        raise StoreError.at(self._file, "is not a regular file", "remove it")

    def _holder(self) -> str:
        words = os.pread(self.handle, 64, 0).decode("ascii", "replace").split()
        return words[1] if len(words) > 1 else "unknown"

    def _sign(self) -> None:
        """Write who holds the lock; on a full disk the lock holds unsigned."""
        with suppress(OSError):
            os.pwrite(self.handle, (_LOCK_MARK + f"{os.getpid()}".encode()).ljust(32) + b"\n", 0)

    def release(self) -> None:
        if self.handle >= 0:
            os.close(self.handle)
            self.handle = -1


def _private(path: str, flags: int) -> int:
    return opened(path, flags, 0o600)


class Ballast:
    """A file of no content, dropped when the disk is full, so that there is room to delete old rows."""

    def __init__(self, path: Path) -> None:
        self._file = beside(path, ".ballast")

    def lay(self) -> bool:
        """Make the file if it is missing or short; False when there is no room for it."""
        with suppress(FileNotFoundError):
            if self._file.stat().st_size >= BALLAST_BYTES:
                return True
        if not self.room():
            return False
        try:
            with open(self._file, "wb", opener=_private) as file:
                os.posix_fallocate(file.fileno(), 0, BALLAST_BYTES)
                os.fsync(file.fileno())
        except OSError as error:
            self.drop()
            if error.errno in {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO}:
                return False
            raise
        return True

    def room(self) -> bool:
        """Tell whether there is room for the ballast without making the disk full again."""
        disk = os.statvfs(self._file.parent)
        return disk.f_bavail * disk.f_frsize >= 2 * BALLAST_BYTES

    def drop(self) -> bool:
        """Delete the file; True when there was one, and so there is room now."""
        try:
            self._file.unlink()
        except OSError:
            return False
        return True
