"""How the inner loops are compiled, and when their compiled code is out of date."""

from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

import numba

_Function = TypeVar("_Function", bound=Callable[..., Any])

_stamps: Final[dict[str, list[object]]] = {}


def compiled(function: _Function) -> _Function:
    """Compile on first use, cache the result on disk, and release the interpreter lock while running.

    numba takes cached code for valid as long as the function's own file is unchanged, but that code also
    holds the compiled functions that it calls. So it is stamped here with the files of all functions of its
    package compiled before it, among which its callees must be; those of other packages may or may not have been
    imported by then. Where there is nowhere to write, nothing is cached.
    """
    return _compiled(function)


def vectorised(function: _Function) -> _Function:
    """Compile like `compiled`, products and sums fused: for long loops over independent elements."""
    return _compiled(function, fastmath={"contract"})


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
    stamps = _stamps.setdefault(function.__module__.rpartition(".")[0], [])
    if index._source_stamp not in stamps:
        stamps.append(index._source_stamp)
    index._source_stamp = tuple(stamps)
    return cast(_Function, dispatcher)
