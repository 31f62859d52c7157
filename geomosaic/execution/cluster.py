"""Workers of a Dask cluster, by its address or its client."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Sequence
from concurrent.futures import CancelledError, Future, wait
from contextlib import suppress
from typing import Any

from geomosaic.errors import InputError, WorkerError, WorkersUnreachableError
from geomosaic.execution.packing import check_versions, versions
from geomosaic.execution.task import run_task
from geomosaic.execution.work import UnitsLostError, Work

# Seconds in which a scheduler has to answer.
SCHEDULER_TIMEOUT = 30
# Seconds between looks at a cluster whose answer is waited for, and without any worker until it is given up.
LOOK, ALONE = 5.0, 120.0
# Functions whose bytes are held on the cluster.
_HELD = 4
# Answers that are fetched at once.
_TOGETHER = 4


class Cluster:
    """Workers of a Dask cluster.

    The packed function is a task of its own: the scheduler makes it again where the worker that held it has died.

    Parameters
    ----------
    client : distributed.Client or str
        A client stays open; of an address one is made, and closed at the end.
    memory : int
        Bytes that each worker must have.

    Raises
    ------
    InputError
        `distributed` is not installed.
    WorkerError
        The scheduler does not answer, has no workers, or workers of another version or of too little memory.
    """

    def __init__(self, client: Any, memory: int) -> None:
        self._own = isinstance(client, str)
        self._client = client = _client(client) if self._own else client
        try:
            threads = client.nthreads()
            if not threads:
                raise WorkerError(
                    "the cluster has no workers", where=_place(client), hint="start workers, then run the command again"
                )
            self.slots, self.kind = sum(threads.values()), f"Dask cluster {_place(client)}"
            self.dashboard: str | None = client.dashboard_link if _has_dashboard(client) else None
            self._check_workers(memory)
        except BaseException:
            self.close()
            raise
        self._held: dict[str, Any] = {}
        self._begun: dict[str, _Task] = {}
        # Workers that hang and that nobody could start anew: they get no more tasks.
        self.hung: set[str] = set()
        self.answered = time.monotonic()

    def _check_workers(self, memory: int) -> None:
        """Check of the versions and the memory of all workers."""
        for worker, found in self._client.run(versions, on_error="return").items():
            if isinstance(found, BaseException):
                raise WorkerError(
                    f"the worker cannot run geomosaic ({type(found).__name__}: {found})",
                    where=worker,
                    hint="install the same geomosaic and the same libraries on the workers as here",
                ) from found
            check_versions(found, worker)
        for worker, its in self._client.scheduler_info(n_workers=-1)["workers"].items():
            limit = its.get("memory_limit") or 0
            if 0 < limit < memory:
                raise WorkerError(
                    f"the worker has {limit >> 20} MB of memory, and units may need {memory >> 20} MB",
                    where=worker,
                    hint="give a smaller `memory_limit`, or workers with more memory",
                )

    def begin(self, work: Work, items: Sequence[Any], patience: float) -> _Task:
        """Begin a task on a worker."""
        data = self._held.pop(work.key, None)
        if data is None:
            key = f"geomosaic-{work.key}-{os.urandom(4).hex()}"
            data = self._client.submit(bytes, work.data, key=key)
        self._held[work.key] = data
        while len(self._held) > _HELD:
            del self._held[next(iter(self._held))]
        key = f"{work.name}-{os.urandom(8).hex()}"
        others = [each for each in self._client.nthreads() if each not in self.hung] if self.hung else None
        future = self._client.submit(_run_task, work.key, data, items, key=key, pure=False, workers=others)
        task = self._begun[key] = _Task(self, self._client, future, patience)
        return task

    def gather(self, wanted: _Task) -> None:
        """Fetch the answer of a task that is over, with those of others that are."""
        # Each time the scheduler and the workers are asked.
        over = [one for one in self._begun.values() if one is not wanted and one.over][: _TOGETHER - 1]
        for task, found in zip(
            (wanted, *over), self._client.gather([one.future for one in (wanted, *over)], direct=True), strict=True
        ):
            task.found = found
            self.forget(task)

    def forget(self, task: _Task) -> None:
        """Let go of a task."""
        self._begun.pop(task.future.key, None)

    def close(self) -> None:
        """Close the client that was made."""
        self._held, self._begun = {}, {}
        if self._own:
            self._client.close()


class _Task:
    """Task on a cluster; its answer comes straight from its worker where that can be reached."""

    def __init__(self, cluster: Cluster, client: Any, future: Any, patience: float) -> None:
        self._cluster, self._client, self.future = cluster, client, future
        self.found: memoryview | None = None
        self._patience, self._begun = patience, time.monotonic()
        self._done = threading.Event()
        future.add_done_callback(lambda _: self._done.set())

    @property
    def over(self) -> bool:
        """Whether its answer can be fetched."""
        return self._done.is_set() and self.future.status == "finished"

    def answer(self) -> bytes | memoryview:
        """Answer, waited for; the cluster may forget it then."""
        from distributed import KilledWorker

        try:
            if self.found is None:
                self._wait()
                self._cluster.gather(self)
        except KilledWorker as error:
            self.cancel()
            raise UnitsLostError("died", str(error)) from error
        except _gone() as error:
            raise WorkersUnreachableError(
                f"the cluster is out of reach ({type(error).__name__}: {error})",
                where=_place(self._client),
                hint="start it anew, then run the same command again: what is whole stays",
            ) from error
        self._cluster.answered = time.monotonic()
        found, self.found = self.found, None
        return found or b""

    def _wait(self) -> None:
        """Wait until the task is over; one whose worker hangs is taken from it."""
        alone: float | None = None
        while not self._done.wait(LOOK):
            now = time.monotonic()
            if self._client.nthreads():
                alone = None
            else:
                alone = alone or now
                if now - alone > ALONE:
                    raise WorkersUnreachableError(
                        f"the cluster has had no workers for {ALONE:.0f} s",
                        where=_place(self._client),
                        hint="start workers, then run the same command again: what is whole stays",
                    )
                continue
            # Tasks that wait behind others on a worker take their turn: what counts is when anything was answered.
            silent = now - max(self._begun, self._cluster.answered)
            if silent > self._patience:
                self._restart_worker()
                self.cancel()
                raise UnitsLostError("hung", f"no answer in {silent:.0f} s")

    def _restart_worker(self) -> None:
        """Restart the worker that has the task, where a nanny watches over it."""
        busy: list[str] = []
        try:
            busy = [worker for worker, keys in self._client.processing().items() if self.future.key in keys]
            self._client.restart_workers(busy, timeout=SCHEDULER_TIMEOUT, raise_for_error=False)
        except Exception:  # without one it keeps hanging, and others do its work
            self._cluster.hung.update(busy)

    def cancel(self) -> None:
        """Drop it."""
        self._cluster.forget(self)
        with suppress(Exception):
            self.future.cancel()


def _run_task(key: str, data: bytes, items: Sequence[Any]) -> memoryview:
    """Answer of a task in a form that Dask does not copy."""
    return memoryview(run_task(key, data, items) or b"")


def _gone() -> tuple[type[BaseException], ...]:
    """Failures by which a whole cluster is out of reach."""
    import distributed.client
    from distributed.comm import CommClosedError

    own = getattr(distributed.client, "FutureCancelledError", None)
    return (CancelledError, CommClosedError, TimeoutError, *(() if own is None else (own,)))


def _place(client: Any) -> str:
    return str(getattr(getattr(client, "scheduler", None), "address", "workers"))


def _has_dashboard(client: Any) -> bool:
    return "dashboard" in client.scheduler_info(n_workers=0).get("services", {})


def _client(address: str) -> Any:
    """Client of the scheduler at an address."""
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
    if security is not None and not (security.tls_ca_file and security.tls_client_cert):
        raise WorkerError(
            "tls:// needs certificates in Dask's configuration, which names none",
            where=address,
            hint="set distributed.comm.tls there, or variables such as DASK_DISTRIBUTED__COMM__TLS__CA_FILE "
            "(and ..._TLS__CLIENT__CERT, ..._TLS__CLIENT__KEY)",
        )
    found: Future[Any] = Future()

    def connect() -> None:
        try:
            found.set_result(Client(address, timeout=SCHEDULER_TIMEOUT, security=security, set_as_default=False))
        except BaseException as error:
            found.set_exception(error)

    # In a thread of its own: Dask has no end of waiting for the greeting of what listens there and is no scheduler.
    threading.Thread(target=connect, name="geomosaic-connect", daemon=True).start()
    try:
        if not wait([found], 2 * SCHEDULER_TIMEOUT).done:
            raise TimeoutError("what listens there says nothing")
        return found.result()
    except (OSError, TimeoutError, TypeError, ValueError) as error:
        raise WorkerError(
            f"no Dask scheduler answers ({error})",
            where=address,
            hint="check the address and that the scheduler runs"
            + (", and the certificates in Dask's configuration" if security else ""),
        ) from error
