"""The rig file ``rig.toml``: what is measured."""

import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, ValidationError, model_validator

from creak.config.fields import Strict
from creak.config.validation import explain, parse_toml, read_text
from creak.errors import ConfigurationError
from creak.multisine import grid_lines
from creak.records import Grid, Hold, Node, Rig

Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[^\s/\p{C}]([^/\p{C}]*[^\s/\p{C}])?$")]
_MAX_NODES = 256
_LONGEST_PERIOD = 1e6  # s; times are counted in 64 bits of nanoseconds


class _NodeTable(Strict):
    name: Name
    output: Annotated[str, Field(min_length=1)]
    input: Annotated[str, Field(min_length=1)] | None = None


class _RigTable(Strict):
    name: Name
    sample_rate: Annotated[float, Field(gt=0, le=1e9, allow_inf_nan=False, strict=True)]
    period_samples: Annotated[int, Field(ge=4, le=2**24, strict=True)]
    transient_periods: Annotated[int, Field(ge=0, le=10**6, strict=True)]
    band: tuple[Annotated[float, Field(strict=True)], Annotated[float, Field(strict=True)]] | None = None
    grid: Grid = "full"
    lines: list[Annotated[int, Field(strict=True)]] | None = None
    hold: Hold = "band-limited"
    network: str | list[tuple[str, str]] = "dense"
    nodes: Annotated[list[_NodeTable], Field(min_length=1, max_length=_MAX_NODES)]

    @model_validator(mode="before")
    @classmethod
    def _names_are_text(cls, data: Any) -> Any:
        """Catch a node named by a bare number, a common slip, before the type error does."""
        for index, node in enumerate(data.get("nodes", []) if isinstance(data, dict) else []):
            if isinstance(node, dict) and isinstance(node.get("name"), int):
                raise ValueError(f"nodes[{index}].name: {node['name']!r} is a number; write it in quotes")
        return data

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        names = [node.name for node in self.nodes]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"nodes: the name {name!r} stands twice; names are unique")
        if "ground" in names:
            raise ValueError("nodes: 'ground' is the fixed world and cannot be the name of a node")
        if all(node.input is None for node in self.nodes):
            raise ValueError("nodes: none is driven; give at least one the unit of its 'input'")
        if self.period_samples / self.sample_rate > _LONGEST_PERIOD:
            raise ValueError(
                f"sample_rate: {self.sample_rate:g} is not allowed: {self.period_samples} samples would last "
                f"longer than {_LONGEST_PERIOD:g} s"
            )
        self._check_lines()
        self._check_network(names)
        return self

    def _check_lines(self) -> None:
        nyquist = self.sample_rate / 2
        if self.lines is None:
            if self.band is None:
                raise ValueError("band: is missing; give 'band' (and 'grid'), or 'lines'")
            low, high = self.band
            if not (math.isfinite(low) and math.isfinite(high) and 0 < low <= high < nyquist):
                raise ValueError(
                    f"band: [{low:g}, {high:g}] is not allowed: should be two frequencies in Hz, rising, "
                    f"above 0 and below half the sample rate ({nyquist:g} Hz)"
                )
            if not grid_lines(self.grid, self.band, self.sample_rate, self.period_samples):
                resolution = self.sample_rate / self.period_samples
                raise ValueError(
                    f"band: [{low:g}, {high:g}] holds no line of the {self.grid} grid; "
                    f"lines are {resolution:g} Hz apart"
                )
            return
        if self.band is not None or "grid" in self.model_fields_set:
            raise ValueError("lines: cannot stand beside 'band' or 'grid'; give one or the other")
        highest = (self.period_samples - 1) // 2
        if not self.lines or min(self.lines) < 1 or max(self.lines) > highest:
            wrong = self.lines and [line for line in self.lines if not 1 <= line <= highest][:1]
            raise ValueError(
                f"lines: {wrong} is not allowed: should be whole numbers from 1 to {highest}, "
                "below half the sample rate"
            )
        for before, line in pairwise(self.lines):
            if line <= before:
                raise ValueError(f"lines: {line} comes after {before}: should rise, each line once")

    def _check_network(self, names: list[str]) -> None:
        if isinstance(self.network, str):
            if self.network != "dense":
                raise ValueError(
                    f"network: {self.network!r} is not allowed: should be 'dense' or a list of pairs of nodes"
                )
            return
        for first, second in self.network:
            for name in (first, second):
                if name not in names:
                    raise ValueError(f"network: {name!r} is not a node; nodes are {', '.join(names)}")
            if first == second:
                raise ValueError(f"network: the pair [{first!r}, {second!r}] joins a node to itself")


def parse_rig(text: str, source: str) -> Rig:
    """Rig from the text of a rig file.

    Parameters
    ----------
    text : str
        TOML.
    source : str
        Name of the file, for messages.

    Raises
    ------
    ConfigurationError
        One line that names file, key and value, and says what is allowed.
    """
    tables = parse_toml(text, source)
    try:
        table = _RigTable.model_validate(tables)
    except ValidationError as error:
        raise explain(error, source) from None
    if table.lines is not None:
        lines = tuple(table.lines)
    else:
        assert table.band is not None
        lines = grid_lines(table.grid, table.band, table.sample_rate, table.period_samples)
    return Rig(
        name=table.name,
        sample_rate=table.sample_rate,
        period_samples=table.period_samples,
        transient_periods=table.transient_periods,
        lines=lines,
        nodes=tuple(Node(name=node.name, output=node.output, input=node.input) for node in table.nodes),
        grid=table.grid,
        hold=table.hold,
        network=None if isinstance(table.network, str) else tuple(table.network),
    )


def load_rig(path: Path) -> Rig:
    """Rig from a rig file.

    Raises
    ------
    ConfigurationError
        If the file cannot be read or holds what is not allowed.
    """
    return parse_rig(read_text(path), str(path))


def rig_toml(rig: Rig) -> str:
    """Text of a rig file for the same rig, the excited lines given one by one.

    ``parse_rig`` of it gives the rig back, but for the name of the grid, which explicit lines replace.
    """
    if rig.name == "" or not rig.nodes:
        raise ConfigurationError("rig", "name", "a rig has a name and nodes")
    rows = [
        f"name = {_text(rig.name)}",
        f"sample_rate = {rig.sample_rate!r}",
        f"period_samples = {rig.period_samples}",
        f"transient_periods = {rig.transient_periods}",
        f"lines = {list(rig.lines)}",
        f"hold = {_text(rig.hold)}",
    ]
    if rig.network is None:
        rows.append('network = "dense"')
    else:
        pairs = ", ".join(f"[{_text(a)}, {_text(b)}]" for a, b in rig.network)
        rows.append(f"network = [{pairs}]")
    for node in rig.nodes:
        rows += ["", "[[nodes]]", f"name = {_text(node.name)}"]
        if node.input is not None:
            rows.append(f"input = {_text(node.input)}")
        rows.append(f"output = {_text(node.output)}")
    return "\n".join(rows) + "\n"


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # so it is a TOML basic string too
