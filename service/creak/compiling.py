"""How the inner loops are compiled, and when their compiled code is out of date."""

from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any, Final, TypeVar, cast

import numba
from numba.core.dispatcher import Dispatcher

_Function = TypeVar("_Function", bound=Callable[..., Any])

_stamps: Final[dict[Any, set[object]]] = {}  # of each compiled function: its file's and those of all that it calls


def compiled(function: _Function) -> _Function:
    """Compile on first use, cache the result on disk, and release the interpreter lock while running.

    numba takes cached code for valid as long as the function's own file is unchanged, but that code also holds the
    compiled functions that it calls. So it is stamped here with their files, too; with no others, or commands that
    import in another order would compile again what is there. Where there is nowhere to write, nothing is cached.
    """
    return _compiled(function)


def vectorised(function: _Function) -> _Function:
    """Compile like `compiled`, products and sums fused: for long loops over independent elements."""
    return _compiled(function, fastmath={"contract"})


def part(function: _Function) -> _Function:
    """Let a function be a part of the `vectorised` or `reducing` loops that call it, as if it stood there.

    Otherwise each of them would hold a copy, and the process the function itself: which of them runs, and so how
    products and sums are fused, would hang on whether the loop was compiled just now or comes from the cache.
    """
    return _compiled(function, fastmath={"contract"}, inline="always")


def reducing(function: _Function) -> _Function:
    """Compile like `vectorised`, sums in any order: for sums over long arrays of finite numbers."""
    return _compiled(function, fastmath={"contract", "reassoc", "nnan", "nsz"})


def _compiled(function: _Function, **options: Any) -> _Function:
    options |= {"nogil": True, "error_model": "numpy"}
    try:
        dispatcher: Any = numba.njit(function, cache=True, **options)
    except RuntimeError:
        return cast(_Function, numba.njit(function, **options))
    index = dispatcher._cache._cache_file
    stamps = {index._source_stamp}.union(*(_stamps[callee] for callee in _called(function)))
    _stamps[dispatcher] = stamps
    index._source_stamp = tuple(sorted(stamps))
    return cast(_Function, dispatcher)


def _called(function: Callable[..., Any]) -> Iterator[Any]:
    """Compiled functions that a function names, in its module or as an attribute of a module there."""
    names = function.__code__.co_names
    for name in names:
        value = function.__globals__.get(name)
        for found in (vars(value).get(name) for name in names) if isinstance(value, ModuleType) else (value,):
            if isinstance(found, Dispatcher) and found in _stamps:
                yield found
