"""Tasks in this process or on a Dask cluster, and reductions whose order hangs on neither.

A reduction combines neighbours in a tree whose shape follows from the number of items alone, so floating-point
sums come out bit for bit alike on any number of workers (of one kind of processor), and here. What a worker held
when it died is computed again.
"""

import asyncio
import pickle
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from functools import partial
from typing import Any, Protocol, TypeVar

from creak.errors import InputError, ServiceError

Item = TypeVar("Item")
Result = TypeVar("Result")

CONNECT_SECONDS = 3.0
_KEPT = 6  # large arguments that stay on the cluster for further calls
_WARNED = "distributed.admin.large-graph-warning-threshold"
_LARGE = 100_000  # bytes beyond which an argument is sent once for all tasks


class Scheduler(Protocol):
    """Where tasks are carried out."""

    def reduce(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        combine: Callable[[Result, Result], Result],
        done: Callable[[], None],
    ) -> Result:
        """Apply a function to items and combine the results in their order.

        Parameters
        ----------
        function, combine : callable
            Of modules that the workers have, too.
        items : sequence
            At least one.
        done : callable
            Called after every item, here.

        Raises
        ------
        Exception
            What the function raised.
        ServiceError
            The cluster cannot carry it out.
        """
        ...


def tree(count: int, leaf: Callable[[int], Result], combine: Callable[[Result, Result], Result]) -> Result:
    """Combine ``leaf(0)`` to ``leaf(count - 1)``, halves first; at most ``log2(count) + 1`` results are held.

    Examples
    --------
    >>> tree(5, str, lambda a, b: f"({a}{b})")
    '(((01)2)(34))'
    """

    def part(first: int, end: int) -> Result:
        if end - first == 1:
            return leaf(first)
        middle = (first + end + 1) // 2
        return combine(part(first, middle), part(middle, end))

    return part(0, count)


class Here:
    """The process itself, one task after the other."""

    def reduce(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        combine: Callable[[Result, Result], Result],
        done: Callable[[], None],
    ) -> Result:
        """Apply a function to items and combine the results in their order."""

        def leaf(index: int) -> Result:
            result = function(items[index])
            done()
            return result

        return tree(len(items), leaf, combine)


class Cluster:
    """A Dask cluster; made by `connected`.

    Parameters
    ----------
    client : distributed.Client
    address : str
    """

    def __init__(self, client: Any, address: str) -> None:
        self._client = client
        self._address = address
        self._kept: deque[tuple[object, dict[str | None, Any]]] = deque(maxlen=_KEPT)

    @property
    def threads(self) -> int:
        """Tasks that its workers carry out at a time, as far as they are there by now."""
        return sum(self._client.nthreads().values())

    def executor(self) -> Executor:
        """The cluster as an executor of `concurrent.futures`."""
        executor: Executor = self._client.get_executor(pure=False)
        return executor

    def reduce(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        combine: Callable[[Result, Result], Result],
        done: Callable[[], None],
    ) -> Result:
        """Apply a function to items and combine the results in their order; what is in between stays there."""
        from distributed import as_completed

        with self._failures_told():
            # The same file may hold something else next time: no task is taken for one that was done before.
            leaves = [self._client.submit(function, item, pure=False) for item in items]
            whole: Any = tree(
                len(leaves), leaves.__getitem__, lambda a, b: self._client.submit(combine, a, b, pure=False)
            )
            waiting = as_completed(leaves, loop=self._client.loop)
            del leaves  # a result is given up by the cluster once it is combined
            for future in waiting:
                if future.status != "finished":
                    future.result()
                done()
            result: Result = whole.result()
            return result

    def map(self, function: Callable[[Item], Result], items: Iterable[Item], /) -> Iterator[Result]:
        """Apply a function to items, a task each, and give the results in their order, as the builtin does.

        Parameters
        ----------
        function : callable
            Of a module that the workers have, too, or `functools.partial` of one: a large argument that it binds
            is sent once, also if it was bound before.
        items : iterable

        Raises
        ------
        Exception
            What the function raised.
        ServiceError
            The cluster cannot carry it out.
        """
        from distributed import as_completed

        bound = function if isinstance(function, partial) else partial(function)
        waiting = list(items)
        # A task goes where its data lie and the scheduler moves few, so every worker gets data and tasks in turn.
        places = [address for address, threads in self._client.nthreads().items() for _ in range(threads)] or [
            None
        ]
        running: dict[Any, tuple[int, str | None]] = {}
        begun = 0

        def begin(address: str | None) -> None:
            nonlocal begun
            if begun < len(waiting):
                own = [self._sent(value, address) for value in bound.args]
                named = {name: self._sent(value, address) for name, value in bound.keywords.items()}
                future = self._client.submit(bound.func, *own, waiting[begun], **named, pure=False)
                running[future] = begun, address
                ended.add(future)
                begun += 1

        with self._failures_told():
            ended = as_completed(loop=self._client.loop)
            results: dict[int, Result] = {}
            for address in places or [None]:
                begin(address)
            try:
                for k in range(len(waiting)):
                    while k not in results:
                        future = next(ended)
                        index, address = running.pop(future)
                        begin(address)
                        results[index] = future.result()
                    yield results.pop(k)
            finally:
                for future in running:
                    future.cancel()

    def _sent(self, value: object, address: str | None) -> object:
        """The value, or where it lies on the cluster if it is large: at best on the worker of that address.

        It is made there by a task, not scattered, so that what a killed worker held comes about anew.
        """
        kept = next((copies for known, copies in self._kept if known is value), None)
        if kept is not None and address in kept:
            return kept[address]
        data = pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
        if len(data) < _LARGE:
            return value
        if kept is None:
            kept = {}
            self._kept.append((value, kept))
        where = {} if address is None else {"workers": [address], "allow_other_workers": True}
        kept[address] = self._client.submit(pickle.loads, data, **where, pure=False)
        return kept[address]

    @contextmanager
    def _failures_told(self) -> Iterator[None]:
        from concurrent.futures import CancelledError

        from distributed import KilledWorker
        from distributed.comm import CommClosedError

        try:
            yield
        except KilledWorker as error:
            raise ServiceError(
                f"--scheduler {self._address}: {error.allowed_failures + 1} workers died over the same task"
            ) from None
        except (CancelledError, CommClosedError):
            raise ServiceError(f"--scheduler {self._address}: the scheduler has gone") from None
        except ModuleNotFoundError as error:
            raise InputError(
                f"--scheduler {self._address}: a worker lacks {error.name}; install creak beside every worker"
            ) from None


@contextmanager
def connected(address: str) -> Iterator[Cluster]:
    """Connect to a Dask scheduler; what it has not begun for us is given up on leaving.

    Parameters
    ----------
    address : str
        For instance ``tcp://10.20.0.1:8786``; without a scheme it is TCP.

    Raises
    ------
    InputError
        `distributed` is not installed, or no scheduler answers there within a few seconds.
    """
    try:
        import dask
        from distributed import Client
    except ModuleNotFoundError:
        raise InputError("--scheduler: needs Dask; install creak[dask]") from None
    why = asyncio.run(_refusal(address))
    if why:
        raise InputError(
            f"--scheduler: {address}: {why}; should be the address of a Dask scheduler such as tcp://127.0.0.1:8786"
        )
    # An argument that many tasks share is sent with the task that unpacks it.
    with (
        dask.config.set({_WARNED: "1 GiB"}),
        Client(address, timeout=CONNECT_SECONDS, name="creak", set_as_default=False) as client,
    ):
        yield Cluster(client, address)


async def _refusal(address: str) -> str:
    """Say why nothing of Dask can be reached at an address; empty if it can.

    A client that fails to connect hangs about for another ten seconds, so the way is tried without one.
    """
    from distributed.comm import connect

    try:
        comm = await connect(address, timeout=CONNECT_SECONDS)
        await comm.close()
    except ValueError as error:
        return str(error)
    except OSError:
        return f"no scheduler answers within {CONNECT_SECONDS:g} s"
    except MemoryError:
        return "what answers there is no Dask scheduler"  # its first bytes were taken for a length
    return ""
