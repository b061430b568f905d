"""The tables of ``[[rigs]]`` that say when its nodes alarm and how alarms live."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from creak.alarm_records import AlarmRules, BaselineRules, Limits
from creak.config.fields import Count, Finite, NotNegative, Positive, Strict


class LimitsTable(Strict):
    """``[rigs.limits]``: when a node alarms."""

    total_to_noise_db: Finite = Limits.total_to_noise_db
    """A window exceeds if its networked ratio lies above this; at 3 dB distortion is as strong as noise."""
    p_value: Annotated[float, Field(gt=0, lt=1)] = Limits.p_value
    """... and its p-value below this."""
    dead_band_db: NotNegative = Limits.dead_band_db
    """An alarm clears this far below the limit."""
    windows: Count = Limits.windows
    """N, windows looked back on."""
    exceeding: Count = Limits.exceeding
    """K, windows of the last N that must exceed, or lie below the dead band."""
    warning_db: Finite | None = Limits.warning_db
    """A lower ratio that raises a warning."""
    false_alarms_per_year: Positive | None = Limits.false_alarms_per_year
    """Of the rig, at most; in place of `p_value`, which then follows from its pace."""

    @model_validator(mode="after")
    def _no_contradiction(self) -> Self:
        if self.exceeding > self.windows:
            raise ValueError(
                f"exceeding: {self.exceeding} is not allowed: should be at most 'windows' ({self.windows})"
            )
        if self.warning_db is not None and self.warning_db >= self.total_to_noise_db:
            raise ValueError(
                f"warning_db: {self.warning_db:g} is not allowed: should be less than 'total_to_noise_db' "
                f"({self.total_to_noise_db:g}), from which an alarm is raised"
            )
        if self.false_alarms_per_year is not None and "p_value" in self.model_fields_set:
            raise ValueError(
                f"p_value: {self.p_value:g} is not allowed beside 'false_alarms_per_year' "
                f"({self.false_alarms_per_year:g}), from which it follows"
            )
        return self

    def limits(self) -> Limits:
        """The record that the monitor takes."""
        return Limits(**self.model_dump())


class AlarmsTable(Strict):
    """``[rigs.alarms]``: delays, shelving and when data are poor."""

    on_delay_s: NotNegative = AlarmRules.on_delay_s
    """How long a condition must stand before its alarm is raised."""
    off_delay_s: NotNegative = AlarmRules.off_delay_s
    """How long it must be gone before its alarm is cleared."""
    realarm_s: Positive | None = AlarmRules.realarm_s
    """After which an acknowledged alarm that still stands comes back; never if left out."""
    shelving_max_s: Positive = AlarmRules.shelving_max_s
    """Longest time for which an alarm can be shelved."""
    silence_s: Positive | None = AlarmRules.silence_s
    """Silence that is an alarm; ten periods, at least 10 s, if left out."""
    stale_realisations: Annotated[float, Field(ge=2, allow_inf_nan=False)] = AlarmRules.stale_realisations
    """An estimate older than this many realisations take is stale."""

    def rules(self) -> AlarmRules:
        """The record that the monitor takes."""
        return AlarmRules(**self.model_dump())


class BaselineTable(Strict):
    """``[rigs.baseline]``: what is learnt of a healthy node."""

    realisations: Annotated[int, Field(ge=0, strict=True)] = BaselineRules.realisations
    """Healthy ones from which a baseline is learnt, four times `window` at least; 0 for none."""
    change_db: Positive = BaselineRules.change_db
    """Rise of the nonlinear level above its baseline that is an alarm."""
    state_tolerance_db: Positive = BaselineRules.state_tolerance_db
    """Excitations within this of each other are one operating state."""
    trend_false_alarms_per_year: Positive | None = BaselineRules.trend_false_alarms_per_year
    """Warnings of slow growth that are false, at most."""

    def rules(self, window: int) -> BaselineRules:
        """The record that the monitor takes.

        Raises
        ------
        ValueError
            If the realisations do not make four windows that share no data.
        """
        least = 4 * window
        if 0 < self.realisations < least:
            raise ValueError(
                f"realisations: {self.realisations} is not allowed: should be 0 for no baselines, or at least "
                f"{least}, four times 'window' ({window}); 25 windows make a change of the spread visible"
            )
        return BaselineRules(**self.model_dump())
