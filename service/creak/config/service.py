"""The service file ``creak.toml`` and the environment that overrides it."""

import ipaddress
import os
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, field_validator, model_validator
from pydantic_settings import (
    BaseSettings,
    EnvSettingsSource,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
    SettingsError,
)

from creak.config.alarms import AlarmsTable, BaselineTable, LimitsTable
from creak.config.can import CanSource
from creak.config.fields import AS_TOLD, Count, Positive, Strict, Told
from creak.config.stream import StreamSource, StreamTable
from creak.config.validation import explain, parse_toml, read_text
from creak.errors import ConfigurationError

PREFIX = "CREAK_"
"""Environment variables that override keys: ``CREAK_SERVER__PORT=8400`` sets ``server.port``."""


class ServerTable(Strict):
    """``[server]``: where the API listens."""

    host: Annotated[str, Field(min_length=1)] = "127.0.0.1"
    """Address to listen on; beyond loopback every request needs a key."""
    port: Annotated[int, Field(ge=0, le=65535)] = 8300
    """Port of the API; 0 for a free one."""
    requests_per_second: Positive = 500.0
    """That one client may make."""


class StoreTable(Strict):
    """``[store]``: where the state lies; empty means SQLite in the data directory."""

    url: str = ""
    """SQLite or PostgreSQL (`postgresql+psycopg://...`); empty for `creak.db` in the data directory."""


class WebhooksTable(Strict):
    """``[webhooks]``: networks beyond the public ones where receivers may live."""

    allow: list[str] = Field(default_factory=list)
    """Networks beyond the public ones where receivers may live."""
    timeout_seconds: Positive = 10.0
    """That one attempt may take."""
    per_minute: Positive = 120.0
    """Requests that one receiver gets at most."""
    disable_after_hours: Positive = 120.0
    """Of failure without a success, after which a receiver is disabled."""

    @field_validator("allow")
    @classmethod
    def _networks(cls, allow: list[str]) -> list[str]:
        for network in allow:
            ipaddress.ip_network(network)
        return allow


class RecordingTable(Strict):
    """``[recording]``: when a new part of a recording is begun, at the next whole realisation."""

    max_bytes: Count = 2_000_000_000
    """Size after which a new part is begun, at the next realisation."""
    max_seconds: Positive = 86_400.0
    """Recorded time after which a new part is begun."""
    budget_bytes: Count | None = None
    """Of all recordings together; the oldest are removed. No limit if left out."""


class JobsTable(Strict):
    """``[jobs]``: diagnoses and replays that are asked for over REST."""

    at_once: Annotated[int, Field(ge=0, le=64, strict=True), AS_TOLD] = 1
    """Diagnoses and replays that run at the same time; 0 for none."""
    max_seconds: Positive = 1800.0
    """After which one is ended."""


class SimulatedSource(Strict):
    """``[rigs.source]`` of kind simulated: the rig's model plays the rig."""

    kind: Literal["simulated"]
    """The rig is simulated by its model."""
    rms: Positive = 1.0
    """RMS value of every input, in its unit."""
    snr_db: Annotated[float, Field(allow_inf_nan=False)] | None = 40.0
    """Signal-to-noise ratio of the responses."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    """Of excitation and noise."""
    steady_periods: Count = 2
    """Periods of an experiment after the transient ones."""
    realisations: Count | None = None
    """How many; without end if left out."""
    pace: Annotated[float, Field(gt=0)] | None = 1.0
    """Recorded seconds a second."""


class RecordingSource(Strict):
    """``[rigs.source]`` of kind recording: parts of one recorded run, in order."""

    kind: Literal["recording"]
    """Recordings are played."""
    files: Annotated[list[Path], Field(min_length=1)]
    """Parts of one recorded run."""


SourceTable = Annotated[SimulatedSource | CanSource | RecordingSource | StreamSource, Field(discriminator="kind")]


class RigTable(Strict):
    """One of ``[[rigs]]``."""

    rig: Path
    """Rig file."""
    model: Path | None = None
    """Model file, for a simulated source and for diagnoses."""
    window: Count = 4
    """Complete realisations over which live levels are taken."""
    limits: LimitsTable = LimitsTable()
    """When a node alarms."""
    alarms: AlarmsTable = AlarmsTable()
    """How alarms live."""
    baseline: BaselineTable = BaselineTable()
    """What is learnt of a healthy node."""
    source: SourceTable
    """Where the frames come from."""

    @model_validator(mode="after")
    def _a_simulated_rig_has_a_model(self) -> Self:
        if self.source.kind == "simulated" and self.model is None:
            raise ValueError("model: is missing; a simulated source needs one")
        return self

    @model_validator(mode="after")
    def _a_baseline_has_windows(self) -> Self:
        try:
            self.baseline.rules(self.window)
        except ValueError as error:
            raise ValueError(f"baseline.{error}") from None
        return self


class _Environment(EnvSettingsSource):
    """The environment, its words marked as such."""

    def __call__(self) -> dict[str, Any]:
        return {name: _told(value) for name, value in super().__call__().items()}


def _told(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _told(item) for key, item in value.items()}
    return Told(value) if isinstance(value, str) else value


class ServiceSettings(BaseSettings):
    """All of ``creak.toml``, overridden from the environment."""

    model_config = SettingsConfigDict(
        env_prefix=PREFIX,
        env_nested_delimiter="__",
        extra="forbid",
        frozen=True,
        hide_input_in_errors=False,
        use_attribute_docstrings=True,
    )

    data: Path = Path("var")
    """Directory of recordings and of the embedded store."""
    server: ServerTable = ServerTable()
    """Where the API listens."""
    store: StoreTable = StoreTable()
    """Where the state lies."""
    webhooks: WebhooksTable = WebhooksTable()
    """How receivers are told."""
    recording: RecordingTable = RecordingTable()
    """How recordings are kept."""
    jobs: JobsTable = JobsTable()
    """Diagnoses and replays that are asked for over REST."""
    stream: StreamTable = StreamTable()
    """Where the broker of a fleet is, and how rigs are shared."""
    rigs: Annotated[list[RigTable], Field(min_length=1)]
    """What is monitored."""

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """The environment wins over the file (which is handed over as the initial values)."""
        return _Environment(settings_cls), init_settings

    @property
    def store_url(self) -> str:
        """URL of the store."""
        return self.store.url or f"sqlite:///{self.data / 'creak.db'}"


def parse_service(tables: dict[str, Any], source: str, base: Path) -> ServiceSettings:
    """Service settings from the tables of a service file and the environment.

    Parameters
    ----------
    tables : dict
        As TOML gives them.
    source : str
        Name of the file, for messages.
    base : Path
        Directory from which relative paths are counted.

    Raises
    ------
    ConfigurationError
        One line that names the file or the environment variable, the key and the value.
    """
    try:
        settings = ServiceSettings(**tables)
    except ValidationError as error:
        raise explain(error, _origin(error, source)) from None
    except SettingsError as error:
        raise _no_json(error) from None
    return settings.model_copy(
        update={
            "data": base / settings.data,
            "stream": settings.stream.anchored(base),
            "store": StoreTable(url=_anchored(settings.store.url, base)),
            "rigs": [_anchored_rig(rig, base) for rig in settings.rigs],
        }
    )


def load_service(path: Path) -> ServiceSettings:
    """Service settings from a file and the environment.

    Raises
    ------
    ConfigurationError
        If the file cannot be read or holds what is not allowed.
    """
    return parse_service(parse_toml(read_text(path), str(path)), str(path), path.parent)


def _origin(error: ValidationError, source: str) -> str:
    """The environment variable that set a wrong value, or else the file."""
    location = [str(part) for part in error.errors()[0]["loc"]]
    for depth in range(len(location), 0, -1):
        name = PREFIX + "__".join(location[:depth]).upper()
        if name in {key.upper() for key in os.environ}:
            return f"environment variable {name}"
    return source


def _no_json(error: SettingsError) -> ConfigurationError:
    """Name the variable whose list or table is not JSON."""
    value = getattr(error.__cause__, "doc", None)
    names = [name for name, told in os.environ.items() if name.upper().startswith(PREFIX) and told == value]
    if not names:
        return ConfigurationError("environment", "", str(error).splitlines()[0])
    key = names[0].upper().removeprefix(PREFIX).replace("__", ".").lower()
    return ConfigurationError(
        f"environment variable {names[0]}", key, f"{value!r} is not JSON, in which lists and tables are told"
    )


def _anchored(url: str, base: Path) -> str:
    """A SQLite URL with a relative path, counted from the service file."""
    scheme, separator, path = url.partition(":///")
    if not separator or not scheme.startswith("sqlite") or path.startswith(("/", ":memory:")) or not path:
        return url
    return f"{scheme}:///{base / path}"


def _anchored_rig(rig: RigTable, base: Path) -> RigTable:
    source = rig.source
    if isinstance(source, RecordingSource):
        source = source.model_copy(update={"files": [base / file for file in source.files]})
    if isinstance(source, CanSource):
        source = source.anchored(base)
    model = None if rig.model is None else base / rig.model
    return rig.model_copy(update={"rig": base / rig.rig, "model": model, "source": source})
