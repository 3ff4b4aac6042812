"""Where parts are computed: processes of this machine, or the workers of a Dask cluster.

Both hand out futures. A local process that dies breaks its pool, which is made anew and the parts under way
are computed again; a Dask scheduler gives the part of a dead worker to another one by itself.
"""

import multiprocessing
import os
import pickle
import signal
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryDirectory
from typing import TYPE_CHECKING, Any, Protocol

from agent import __version__
from agent.errors import StoreError, UsageError
from agent.runtime.process.parent import end_with_parent
from agent.runtime.tuning import SCHEDULER_S

if TYPE_CHECKING:
    from distributed import Client

Compute = Callable[..., Any]


class Pool(Protocol):
    """Computes parts in other processes.

    Attributes:
        size: how many at once.
        given_up: what futures raise whose part ended one process after another.
    """

    size: int
    given_up: tuple[type[Exception], ...]

    def submit(self, act: Compute, *values: object) -> Future[Any]:
        """Have something computed."""

    def renew(self) -> None:
        """Go on after a process died with what it computed."""

    def close(self) -> None:
        """End what was begun."""


class LocalPool:
    """Processes of this machine, begun by a thread: a signal that ends the command leaves none half begun.

    They leave what they computed in files and answer with their names: of a long answer a process that dies
    meanwhile leaves a part in the pipe, and the executor would wait for the rest for ever. A name is written
    whole or not at all.

    Args:
        size: how many; None for one a core.
    """

    given_up: tuple[type[Exception], ...] = ()

    def __init__(self, size: int | None = None) -> None:
        self.size = size or len(os.sched_getaffinity(0))
        self._folder = TemporaryDirectory(prefix="deltak-parts-")
        self._beginner = ThreadPoolExecutor(1)
        self._executor: Executor = self._made()

    def _made(self) -> ProcessPoolExecutor:
        # copies of a process of their own: of this one they would have the store's threads only half
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["agent.runtime.reestimation.parts"])
        return ProcessPoolExecutor(self.size, context, initializer=_begun)

    def submit(self, act: Compute, *values: object) -> Future[Any]:
        begin = partial(self._executor.submit, _left, self._folder.name, act, *values)
        future: Future[Any] = Future()
        self._beginner.submit(begin).result().add_done_callback(partial(_fetch, future))
        return future

    def renew(self) -> None:
        self._executor.shutdown(wait=True)
        self._executor = self._made()

    def close(self) -> None:
        self._beginner.shutdown(wait=True)
        self._executor.shutdown(wait=True, cancel_futures=True)
        self._folder.cleanup()


class DaskPool:
    """Workers of a Dask cluster, which need this version of deltak and the archive under the same paths.

    Args:
        address: of its scheduler, as Dask writes it.

    Raises UsageError where it cannot be used.
    """

    def __init__(self, address: str) -> None:
        from distributed import KilledWorker

        self._client = _client(address)
        self.given_up: tuple[type[Exception], ...] = (KilledWorker,)
        try:
            self._check(address)
        except BaseException:
            self._client.close()
            raise
        self._executor: Executor = self._client.get_executor(pure=False)

    def _check(self, address: str) -> None:
        try:
            self._client.wait_for_workers(1, timeout=SCHEDULER_S)
            versions = self._client.run(_version)
        except TimeoutError as error:
            raise _unusable(
                address, "has no workers", "start some: dask worker ADDRESS --nthreads 1"
            ) from error
        except ImportError as error:
            raise _unusable(address, f"its workers: {error}", "install deltak there too") from error
        other = next(((worker, found) for worker, found in versions.items() if found != __version__), None)
        if other is not None:
            what = f"the worker {other[0]} has deltak {other[1]}, not {__version__}"
            raise _unusable(address, what, "install the same version everywhere")
        self.size = sum(self._client.nthreads().values())

    def submit(self, act: Compute, *values: object) -> Future[Any]:
        return self._executor.submit(act, *values)

    def renew(self) -> None:
        """Nothing: the scheduler gives the part to another worker."""

    def close(self) -> None:
        self._executor.shutdown(wait=False)
        self._client.close()


def pool_of(scheduler: str, size: int | None) -> Pool:
    """Return the pool that a scheduler's name or address means. Raises UsageError."""
    if scheduler == "local":
        return LocalPool(size)
    kind, separator, place = scheduler.partition("://")
    if kind not in {"dask", "tcp", "tls"} or not separator or ":" not in place:
        advice = 'say "local", or where a Dask scheduler is: dask://HOST:PORT, tls://HOST:PORT'
        raise UsageError.at("--scheduler", f'"{scheduler}" is neither local nor an address', advice)
    if size is not None:
        raise UsageError.at("--workers", "is for the local scheduler", "start Dask workers as you need them")
    try:
        return DaskPool(f"{'tls' if kind == 'tls' else 'tcp'}://{place}")
    except ModuleNotFoundError as error:
        raise UsageError.at("--scheduler", "Dask is not installed", "pip install 'deltak[dask]'") from error


def _client(address: str) -> "Client":
    from distributed import Client

    try:
        return Client(address, timeout=SCHEDULER_S, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise _unusable(address, "no scheduler answers", "see that it runs, and its address") from error


def _left(folder: str, act: Compute, *values: object) -> str:
    """Compute something, leave it in a file and return its name. Raises StoreError, and what it raises."""
    answer = pickle.dumps(act(*values), 5)
    try:
        with NamedTemporaryFile(dir=folder, delete=False) as file:
            file.write(answer)
    except OSError as error:
        raise _unkept(folder, error) from error
    return file.name


def _fetch(future: Future[Any], left: Future[str]) -> None:
    """Give a future what was left in a file, or what was raised instead."""
    if left.cancelled():
        future.cancel()
    elif (error := left.exception()) is not None:
        future.set_exception(error)
    else:
        path = Path(left.result())
        try:
            answer = pickle.loads(path.read_bytes())  # noqa: S301 - a process of ours left it
            path.unlink()
        except OSError as lost:
            future.set_exception(_unkept(str(path.parent), lost))
        else:
            future.set_result(answer)


def _unkept(folder: str, error: OSError) -> StoreError:
    what = f"cannot hold what was computed: {error}"
    return StoreError.at(folder, what, "make room there, or set TMPDIR to another folder")


def _begun() -> None:
    """Leave an interrupt to the process that all this is for, and end when it does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent(os.getppid())


def _version() -> str:
    return __version__


def _unusable(address: str, what: str, advice: str) -> UsageError:
    return UsageError.at("--scheduler", f"{address}: {what}", advice)
