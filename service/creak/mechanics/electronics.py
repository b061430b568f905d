"""Effects of amplifiers and sensors, on sampled inputs and responses.

All of them act on samples, as a digital-to-analogue or analogue-to-digital converter and its firmware do: what
an actuator effect leaves is then held between samples by the rig, and what a sensor effect leaves is recorded.
A delay is the exact periodic shift of a period by any fraction of a sample, ``Y_k exp(-j w_k delay)``; so it
holds in steady state, and a transient period is shifted as if it repeated itself.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from creak.mechanics import laws
from creak.mechanics.effects import GROUND, Effect
from creak.records import Real

Memory = tuple[float, float]
"""Input and Bouc-Wen memory at the last sample."""

AT_REST: Memory = (0.0, 0.0)


def delayed(samples: Real, delay: float, sample_rate: float) -> Real:
    """Shift periods in time by any number of samples.

    Parameters
    ----------
    samples : array, (..., N)
        Whole periods.
    delay : float
        Seconds; positive is later.
    sample_rate : float
        Hz.

    Returns
    -------
    array, (..., N)
    """
    size = samples.shape[-1]
    shift = delay * sample_rate
    if shift == round(shift):
        return np.roll(samples, round(shift), axis=-1)
    spectrum = np.fft.rfft(samples)
    turn = np.exp(-2j * np.pi * np.arange(spectrum.shape[-1]) * shift / size)
    if size % 2 == 0:
        turn[-1] = math.cos(math.pi * shift)  # the Nyquist line is real: half of it turns either way
    return np.fft.irfft(spectrum * turn, n=size)


@dataclass(frozen=True)
class Electronic(Effect):
    """An effect at one actuator or one sensor; alone it leaves the samples as they are."""

    def _check_place(self) -> None:
        if len(self.at) != 1 or self.at[0] == GROUND:
            raise self.refusal("at", f"{list(self.at)}, must name one node")

    def apply(self, samples: Real, sample_rate: float, memory: Memory = AT_REST) -> tuple[Real, Memory]:
        """Pass one period through.

        Parameters
        ----------
        samples : array, (N,)
            One period of the input or response.
        sample_rate : float
            Hz.
        memory : pair of float
            As the call for the period before returned it; `AT_REST` at the beginning.

        Returns
        -------
        array, (N,)
        pair of float
            Memory for the next period.
        """
        return self._passed(samples, sample_rate), memory

    def _passed(self, samples: Real, sample_rate: float) -> Real:
        """Pass one period through an effect without memory."""
        raise NotImplementedError


class Actuator(Electronic):
    """Applied to an input before it acts."""


class Sensor(Electronic):
    """Applied to a response before it is recorded."""


@dataclass(frozen=True)
class ActuatorGain(Actuator):
    """Input times gain."""

    effect: ClassVar[str] = "actuator_gain"
    gain: float

    def _passed(self, samples: Real, sample_rate: float) -> Real:
        return self.gain * samples


@dataclass(frozen=True)
class ActuatorDelay(Actuator):
    """Input later by delay seconds."""

    effect: ClassVar[str] = "actuator_delay"
    delay: float

    def _passed(self, samples: Real, sample_rate: float) -> Real:
        return delayed(samples, self.delay, sample_rate)


@dataclass(frozen=True)
class ActuatorSaturation(Actuator):
    """Input cut to ``[-limit, limit]``."""

    effect: ClassVar[str] = "actuator_saturation"
    positive: ClassVar[frozenset[str]] = frozenset({"limit"})
    limit: float

    def _passed(self, samples: Real, sample_rate: float) -> Real:
        return np.clip(samples, -self.limit, self.limit)


@dataclass(frozen=True)
class ActuatorDeadZone(Actuator):
    """No input within ``[-width, width]``; beyond it the rest: ``u - clip(u, -width, width)``."""

    effect: ClassVar[str] = "actuator_dead_zone"
    not_negative: ClassVar[frozenset[str]] = frozenset({"width"})
    width: float

    def _passed(self, samples: Real, sample_rate: float) -> Real:
        return samples - np.clip(samples, -self.width, self.width)


@dataclass(frozen=True)
class ActuatorHysteresis(Actuator):
    """Share of the input that passes through a Bouc-Wen element: ``(1 - share) u + share z``."""

    effect: ClassVar[str] = "actuator_hysteresis"
    positive: ClassVar[frozenset[str]] = frozenset({"yield_input"})
    not_negative: ClassVar[frozenset[str]] = frozenset({"share"})
    share: float
    yield_input: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.share > 1:
            raise self.refusal("share", f"{self.share!r}, must not be greater than 1")

    def apply(self, samples: Real, sample_rate: float, memory: Memory = AT_REST) -> tuple[Real, Memory]:
        """Pass one period through, on from the memory that the period before has left."""
        z, last = laws.play(np.ascontiguousarray(samples), *memory, self.yield_input)
        return (1 - self.share) * samples + self.share * z, (float(samples[-1]), last)


@dataclass(frozen=True)
class SensorGain(Sensor):
    """Response times gain."""

    effect: ClassVar[str] = "sensor_gain"
    gain: float

    def _passed(self, samples: Real, sample_rate: float) -> Real:
        return self.gain * samples


@dataclass(frozen=True)
class SensorDelay(Sensor):
    """Response later by delay seconds."""

    effect: ClassVar[str] = "sensor_delay"
    delay: float

    def _passed(self, samples: Real, sample_rate: float) -> Real:
        return delayed(samples, self.delay, sample_rate)


@dataclass(frozen=True)
class SensorClipping(Sensor):
    """Response cut to ``[-limit, limit]``."""

    effect: ClassVar[str] = "sensor_clipping"
    positive: ClassVar[frozenset[str]] = frozenset({"limit"})
    limit: float

    def _passed(self, samples: Real, sample_rate: float) -> Real:
        return np.clip(samples, -self.limit, self.limit)


@dataclass(frozen=True)
class SensorQuantisation(Sensor):
    """Response rounded to multiples of step."""

    effect: ClassVar[str] = "sensor_quantisation"
    positive: ClassVar[frozenset[str]] = frozenset({"step"})
    step: float

    def _passed(self, samples: Real, sample_rate: float) -> Real:
        return self.step * np.round(samples / self.step)
