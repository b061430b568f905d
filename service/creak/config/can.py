"""``[rigs.source]`` of kind can: a bus or its logs, and which signals of the DBC are what."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, ValidationError, model_validator

from creak.config.fields import Count, Positive, Strict
from creak.config.validation import explain, parse_toml, read_text

Name = Annotated[str, Field(min_length=1)]
Option = str | int | float | bool


class CounterTable(Strict):
    """``counters.<message>``: by which counter the samples of one message are placed."""

    signal: Name
    """In the message itself, or in the SYNC message that goes before it."""
    counts: Literal["samples", "frames"] = "samples"
    """What it counts."""
    wraps: Annotated[int, Field(ge=2, strict=True)] | None = None
    """Value at which it begins again; that of its bits if left out."""
    offset: Annotated[int, Field(strict=True)] = 0
    """Samples by which the message is late."""


class SignalsTable(Strict):
    """``[rigs.source.signals]``: names as ``Message.Signal``; ``{}`` stands for 0, 1, 2 ... in one frame."""

    inputs: dict[str, Name | list[Name]] = Field(default={})
    """Signals of the inputs by node, `Message.Signal`; `{}` stands for 0, 1, 2 ... in one frame."""
    responses: dict[str, Name | list[Name]] = Field(default={})
    """Signals of the responses by node."""
    counter: Name | None = None
    """Signal of the sample counter."""
    counts: Literal["samples", "frames"] = "samples"
    """What the counter counts."""
    wraps: Annotated[int, Field(ge=2, strict=True)] | None = None
    """Value at which the counter begins again."""
    counters: dict[str, CounterTable] = Field(default={})
    """Counters of messages that have their own, by message."""
    realisation: Name | None = None
    """Signal of the marker."""
    experiment: Name | None = None
    """Signal of the marker."""
    period: Name | None = None
    """Signal of the marker."""
    valid: list[Name] = Field(default=[])
    """Signals that must not be 0."""
    checksum: list[Name] = Field(default=[])
    """Signals that hold a checksum of their frame."""

    @model_validator(mode="after")
    def _markers_from_the_coarsest(self) -> Self:
        given = [name for name in ("realisation", "experiment", "period") if getattr(self, name) is not None]
        for finer, coarser in (("period", "experiment"), ("experiment", "realisation")):
            if finer in given and coarser not in given:
                raise ValueError(f"{coarser}: is missing; a marker '{finer}' means nothing without it")
        return self

    @property
    def markers(self) -> tuple[str, ...]:
        """Names of the markers' signals that are given, from the coarsest on."""
        return tuple(name for name in (self.realisation, self.experiment, self.period) if name is not None)


class CanSource(Strict):
    """``[rigs.source]`` of kind can."""

    kind: Literal["can"]
    """A CAN bus, or its logs."""
    dbc: Path
    """Describes the frames."""
    interface: Name | None = None
    """Of python-can, such as socketcan."""
    channel: Annotated[int, Field(strict=True)] | Name | None = None
    """Of the interface, such as can0."""
    fd: bool = False
    """CAN FD."""
    bitrate: Count | None = None
    """Of the bus."""
    data_bitrate: Count | None = None
    """Of CAN FD."""
    options: dict[str, Option] = Field(default={})
    """Further ones of the interface."""
    logs: list[Path] = Field(default=[])
    """Files instead of an interface."""
    steady_periods: Count = 2
    """Periods of an experiment after the transient ones."""
    silence: Positive = 1.0
    """Seconds without a frame of the rig after which it is silent."""
    patience: Annotated[float, Field(gt=0, lt=1)] = 0.5
    """Periods that a frame may be late."""
    signals: SignalsTable = SignalsTable()
    """Which signal is what; told by their names if left out."""

    @model_validator(mode="after")
    def _a_bus_or_logs(self) -> Self:
        if (self.interface is None) == (not self.logs):
            raise ValueError("interface: give either 'interface' (and 'channel') for a bus, or 'logs'")
        if self.data_bitrate is not None and self.bitrate is None:
            raise ValueError("bitrate: is missing; 'data_bitrate' is given")
        return self

    def anchored(self, base: Path) -> "CanSource":
        """Return the same with paths counted from a directory."""
        return self.model_copy(update={"dbc": base / self.dbc, "logs": [base / log for log in self.logs]})


def load_signals(path: Path) -> SignalsTable:
    """Read a file that holds the keys of ``[rigs.source.signals]``.

    Raises
    ------
    ConfigurationError
        If the file cannot be read or holds what is not allowed.
    """
    try:
        return SignalsTable.model_validate(parse_toml(read_text(path), str(path)))
    except ValidationError as error:
        raise explain(error, str(path)) from None
