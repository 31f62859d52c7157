"""Workers outside of this process: local processes, an executor, or a Dask cluster, behind one small contract."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import CancelledError, Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, Protocol

from geomosaic.digests import digest_of
from geomosaic.errors import InputError, WorkerError
from geomosaic.execution.packing import check_versions, run, versions

# Seconds in which a scheduler has to answer.
SCHEDULER_TIMEOUT = 30


class Pending(Protocol):
    """Result that is on its way."""

    def result(self) -> Any:
        """Result, waited for."""

    def cancel(self) -> Any:
        """Drop it, if it has not begun."""


class Workers(Protocol):
    """Workers that run one packed function.

    Attributes
    ----------
    slots : int
        Items that run at the same time.
    lost : tuple of exception types
        Failures after which an item is not begun again: workers have died with it as often as they may.
    gone : tuple of exception types
        Failures by which all workers are out of reach.
    """

    slots: int
    lost: tuple[type[BaseException], ...]
    gone: tuple[type[BaseException], ...]

    def submit(self, item: Any) -> Pending:
        """Begin an item as soon as there is a free worker."""


@contextmanager
def workers_of(wanted: Any, data: bytes) -> Iterator[Workers]:
    """Workers for one packed function.

    Parameters
    ----------
    wanted : int, str, Executor or Client
        Number of processes of this machine, address of a Dask scheduler, an executor of `concurrent.futures`, or a
        `distributed.Client`; what is given open stays open.
    data : bytes
        See `packing.packed`.

    Yields
    ------
    Workers

    Raises
    ------
    WorkerError
        The scheduler does not answer, has no workers, or workers of another version.
    InputError
        `distributed` is not installed.
    """
    if isinstance(wanted, int):
        pool = _Processes(wanted, data)
        try:
            yield pool
        finally:
            pool.close()
    elif isinstance(wanted, Executor):
        yield _Executor(wanted, data)
    elif isinstance(wanted, str):
        with _client(wanted) as client:
            yield _Dask(client, data)
    else:
        yield _Dask(wanted, data)


class _Processes:
    """Processes of this machine; those that die are replaced."""

    lost: tuple[type[BaseException], ...] = ()
    gone: tuple[type[BaseException], ...] = ()

    def __init__(self, count: int, data: bytes) -> None:
        self.slots, self._data = count, data
        self._pool = self._started()

    def _started(self) -> ProcessPoolExecutor:
        # Forked, they would inherit the locks of threads that are not there.
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self.slots, context, initializer=_receive, initargs=(self._data,))

    def submit(self, item: Any) -> Pending:
        """Begin an item in a process."""
        try:
            return self._pool.submit(_run_received, item)
        except BrokenProcessPool:  # a dead process takes all others of its pool along
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = self._started()
            return self._pool.submit(_run_received, item)

    def close(self) -> None:
        """End the processes."""
        self._pool.shutdown(wait=True, cancel_futures=True)


# What a process of a pool was started with, once for all its items.
_received: list[tuple[str, bytes]] = []


def _receive(data: bytes) -> None:
    import signal

    # Ctrl-C reaches every process of the terminal: the one that was started ends its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _received[:] = [(digest_of(data), data)]


def _run_received(item: Any) -> Any:
    return run(*_received[0], item)


class _Executor:
    """Any executor of `concurrent.futures`; each item goes along with the packed function."""

    lost: tuple[type[BaseException], ...] = ()
    gone: tuple[type[BaseException], ...] = (BrokenProcessPool,)

    def __init__(self, executor: Executor, data: bytes) -> None:
        self.slots = getattr(executor, "_max_workers", None) or os.cpu_count() or 1
        self._executor, self._call = executor, (digest_of(data), data)

    def submit(self, item: Any) -> Pending:
        """Begin an item."""
        return self._executor.submit(run, *self._call, item)


class _Dask:
    """Workers of a Dask cluster.

    The packed function is a task of its own: the scheduler makes it again where the worker that held it has died.
    """

    def __init__(self, client: Any, data: bytes) -> None:
        from distributed import KilledWorker
        from distributed.comm import CommClosedError

        self._client, self._key = client, digest_of(data)
        self.lost: tuple[type[BaseException], ...] = (KilledWorker,)
        self.gone: tuple[type[BaseException], ...] = (CancelledError, *_cancelled(), CommClosedError)
        threads = client.nthreads()
        if not threads:
            raise WorkerError(
                "the cluster has no workers", where=_place(client), hint="start workers, then run the command again"
            )
        self.slots = sum(threads.values())
        for worker, found in client.run(versions, on_error="return").items():
            if isinstance(found, BaseException):
                raise WorkerError(
                    f"the worker cannot run geomosaic ({type(found).__name__}: {found})",
                    where=worker,
                    hint="install the same geomosaic and the same libraries on the workers as here",
                ) from found
            check_versions(found, worker)
        self._data = client.submit(bytes, data, key=f"geomosaic-{self._key}-{os.urandom(4).hex()}")

    def submit(self, item: Any) -> Pending:
        """Begin an item on a worker."""
        return _DaskResult(self._client, self._client.submit(run, self._key, self._data, item, pure=False))


class _DaskResult:
    """Result on a cluster, which comes straight from its worker where that can be reached."""

    def __init__(self, client: Any, future: Any) -> None:
        self._client, self._future = client, future

    def result(self) -> Any:
        """Result, waited for; the cluster may forget it then."""
        return self._client.gather(self._future, direct=True)

    def cancel(self) -> None:
        """Drop it, if it has not begun."""
        self._future.cancel()


def _cancelled() -> tuple[type[BaseException], ...]:
    import distributed.client

    own = getattr(distributed.client, "FutureCancelledError", None)
    return () if own is None else (own,)


def _place(client: Any) -> str:
    return str(getattr(getattr(client, "scheduler", None), "address", "workers"))


@contextmanager
def _client(address: str) -> Iterator[Any]:
    """Client of the scheduler at an address, closed at the end."""
    try:
        from distributed import Client, Security
    except ImportError:
        raise InputError(
            "workers of a cluster need Dask's distributed, which is not installed",
            where="`workers`",
            hint="pip install 'geomosaic[cluster]', or give a number of processes of this machine",
        ) from None
    # Certificates are those of Dask's own configuration (distributed.comm.tls), never of a project file.
    security = Security(require_encryption=True) if address.startswith("tls:") else None
    try:
        client = Client(address, timeout=SCHEDULER_TIMEOUT, security=security, set_as_default=False)
    except (OSError, TimeoutError, TypeError, ValueError) as error:
        raise WorkerError(
            f"no Dask scheduler answers ({error})",
            where=address,
            hint="check the address and that the scheduler runs; tls:// needs certificates in Dask's configuration",
        ) from error
    try:
        yield client
    finally:
        client.close()
