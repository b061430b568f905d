"""How the inner loops are compiled, and when their compiled code is out of date."""

from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

import numba

_Function = TypeVar("_Function", bound=Callable[..., Any])

_stamps: Final[list[object]] = []


def compiled(function: _Function) -> _Function:
    """Compile on first use, cache the result on disk, and release the interpreter lock while running.

    numba takes cached code for valid as long as the function's own file is unchanged, but that code also
    holds the compiled functions that it calls. So it is stamped here with the files of all functions
    compiled before it, among which its callees must be. Where there is nowhere to write, nothing is cached.
    """
    try:
        dispatcher: Any = numba.njit(function, nogil=True, error_model="numpy", cache=True)
    except RuntimeError:
        return cast(_Function, numba.njit(function, nogil=True, error_model="numpy"))
    index = dispatcher._cache._cache_file
    if index._source_stamp not in _stamps:
        _stamps.append(index._source_stamp)
    index._source_stamp = tuple(_stamps)
    return cast(_Function, dispatcher)
