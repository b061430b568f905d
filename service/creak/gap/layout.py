"""Arrays in one layout, so that sums over them round alike in every process that they are sent to."""

from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def settle(record: "DataclassInstance") -> None:
    """Put the arrays of a frozen record into C order, for its ``__post_init__``.

    Pickling does so with an array whose axes are swapped or cut, and a product of matrices then takes another way
    through the library, which may round otherwise.
    """
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, np.ndarray):
            object.__setattr__(record, field.name, np.ascontiguousarray(value))
