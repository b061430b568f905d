"""What the service file says about streams: where the broker is, and how rigs are shared."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from creak.config.fields import Count, Positive, Strict


class StreamTable(Strict):
    """``[stream]``: the broker between workers and analysers."""

    url: Annotated[str, Field(pattern=r"^(nats|tls)://.+")] = "nats://127.0.0.1:4222"
    """Of the broker, NATS with JetStream."""
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")] = "creak"
    """Name of the stream; subjects begin with it."""
    credentials: Path | None = None
    """File with the user's credentials; none if left out."""
    send: Literal["sums", "frames"] = "sums"
    """What a worker sends: sums of realisations, or all their frames."""
    keep_seconds: Positive = 7 * 86_400.0
    """For which the broker keeps what it got, should the stream have to be made."""
    keep_bytes: Count | None = None
    """Of the stream; the oldest go first. No limit if left out."""
    lease_seconds: Annotated[float, Field(ge=1.0, le=3600.0)] = 12.0
    """After which the rigs of an analyser that is gone are taken over."""
    repair_seconds: Positive = 60.0
    """For which an analyser waits for what is missing before it goes on without it."""
    metrics_port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """Where a worker or analyser tells Prometheus its own figures, on loopback; nowhere if left out."""

    @model_validator(mode="after")
    def _kept_for_longer_than_a_gap_may_last(self) -> Self:
        if self.keep_seconds < self.repair_seconds:
            raise ValueError(f"keep_seconds: {self.keep_seconds:g} is less than repair_seconds")
        return self

    def anchored(self, base: Path) -> "StreamTable":
        """The same with paths counted from a folder."""
        path = self.credentials
        return self if path is None else self.model_copy(update={"credentials": base / path})


class StreamSource(Strict):
    """``[rigs.source]`` of kind stream: the rig is measured by a worker elsewhere."""

    kind: Literal["stream"]
    """The rig is measured by a worker elsewhere."""
