"""What the tables of configuration files are made of."""

from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field


class Told(str):
    """Text of an environment variable, which knows no types: a whole number may be meant."""

    __slots__ = ()


def _whole(value: object) -> object:
    return int(value) if isinstance(value, Told) and value.strip().lstrip("+-").isdecimal() else value


AS_TOLD = BeforeValidator(_whole)
"""Comes last in a whole number's annotation, which stays strict about what a file says."""

Count = Annotated[int, Field(ge=1, strict=True), AS_TOLD]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class Strict(BaseModel):
    """A table that knows its keys and does not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)
