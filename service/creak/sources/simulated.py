"""A rig that is simulated: time stepping of a model, and white sensor noise."""

import math
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import count, islice
from typing import Final

import numpy as np

from creak import __version__
from creak.errors import ConfigurationError
from creak.mechanics.electronics import Sensor
from creak.mechanics.newmark import Resolution, Stepper, choose_substeps
from creak.mechanics.system import Model, System, assemble
from creak.multisine import realisation as multisine
from creak.records import Excitation, Frame, Limits, Real, Rig, Run

SENSOR_NOISE: Final = 1
"""Purpose of the random stream ``SeedSequence((seed, realisation, purpose))``; the excitation's is 0."""

AHEAD: Final = 2  # realisations that are simulated while the frames of the one before are taken


@dataclass(frozen=True, eq=False)
class _Chosen:
    """How a model is stepped; ``resolution`` is None where the steps were given."""

    steppers: tuple[Stepper, ...]
    sensors: tuple[tuple[Sensor, ...], ...]
    resolution: Resolution | None


@dataclass(frozen=True, eq=False)
class _Begun:
    """A realisation that is being simulated; its futures give None if that was stopped.

    Parameters
    ----------
    index : int
    inputs : array, (q, q, N)
        Experiment, input, sample.
    chosen : Future of _Chosen
    responses : tuple of Future, (q,)
        Each ``(periods, n, N)``, without noise.
    """

    index: int
    inputs: Real
    chosen: Future[_Chosen | None]
    responses: tuple[Future[Real | None], ...]


class SimulatedRig:
    """A model on a rig, excited by multisines, as a source of period frames.

    Every experiment starts from rest. Realisation m is the same whatever came before it, so a run can be
    made again from its parameters alone. The noise is white and Gaussian, its strength per node fixed by the
    first realisation's noise-free steady response.

    Parameters
    ----------
    rig : Rig
    model : Model
    steady_periods : int
        P, periods of every experiment that count after the transient ones.
    rms : float
        RMS value of every input in its unit.
    seed : int
        Of excitation and noise.
    snr_db : float or None
        Ratio of response to noise power at every node, over all lines, dB; None for no noise.
    realisations : int or None
        How many; None for as many as are asked for.
    start : int
        Recorded time of the first sample, ns since the Unix epoch.
    pace : float or None
        Recorded seconds a second: at 1.0 a frame comes when its last sample would have been taken; None for
        as fast as possible. `pace` may be set while frames are taken.
    changes : sequence of (int, Model)
        From these realisations on another model acts.
    run_id : str
        Unique id of the run.
    window : int
        Realisations over which live levels are taken.
    limits : Limits or None
        Alarm limits; None for the usual ones.
    substeps : int or None
        Time steps a sample; None for as many as the noise asks for.
    threads : int or None
        Experiments that are simulated at a time, which changes no bit of them; None for one a processor.

    Raises
    ------
    ConfigurationError
        If a model does not fit the rig, or a parameter is out of range; it is named.

    Notes
    -----
    Unless it is given, the number of time steps a sample is chosen for every model when its first realisation
    comes, so that the stepping error lies 10 dB below the noise; see `resolution`. That is over all lines, where
    white noise has its power, while the error has its own at the excited ones; so every experiment is also stepped
    half as finely, and the two are extrapolated: the scheme is of second order, ``(4 y_h - y_2h)/3`` of fourth.
    A given number of steps is taken as it is, without extrapolation.
    """

    live: bool = False  # a simulation can wait

    def __init__(
        self,
        rig: Rig,
        model: Model,
        *,
        steady_periods: int,
        rms: float,
        seed: int,
        snr_db: float | None = None,
        realisations: int | None = None,
        start: int = 0,
        pace: float | None = None,
        changes: Sequence[tuple[int, Model]] = (),
        run_id: str = "simulated",
        window: int = 4,
        limits: Limits | None = None,
        substeps: int | None = None,
        threads: int | None = None,
    ) -> None:
        _check("steady_periods", steady_periods, steady_periods >= 1, "1 or more")
        _check("rms", rms, 0 < rms < math.inf, "finite and greater than 0")
        _check("seed", seed, seed >= 0, "0 or greater")
        _check("snr_db", snr_db, snr_db is None or math.isfinite(snr_db), "finite")
        _check("realisations", realisations, realisations is None or realisations >= 1, "1 or more")
        _check("substeps", substeps, substeps is None or substeps >= 1, "1 or more")
        _check("threads", threads, threads is None or threads >= 1, "1 or more")
        _check_pace(pace)
        self.run = Run(
            id=run_id,
            rig=rig,
            steady_periods=steady_periods,
            start=start,
            excitation=Excitation("multisine", rms=rms, seed=seed),
            source="simulated",
            window=window,
            limits=limits or Limits(),
            software=__version__,
        )
        self.resolution: Resolution | None = None
        """Steps a sample of the model that acts now, and their error; None before the first realisation."""
        self._systems = [(0, assemble(model, rig))]
        self._systems += [(m, assemble(other, rig)) for m, other in sorted(changes, key=lambda change: change[0])]
        self._rms = rms
        self._seed = seed
        self._snr_db = snr_db
        self._realisations = realisations
        self._substeps = substeps
        self._threads = threads or os.cpu_count() or 1
        self._wake = threading.Condition()
        self._closed = False
        self._pace = pace

    @property
    def pace(self) -> float | None:
        """Recorded seconds a second, None for as fast as possible; a change acts at once."""
        return self._pace

    @pace.setter
    def pace(self, pace: float | None) -> None:
        _check_pace(pace)
        with self._wake:
            self._pace = pace
            self._wake.notify_all()

    def close(self) -> None:
        """End `frames` soon, also from another thread and while it waits."""
        with self._wake:
            self._closed = True
            self._wake.notify_all()

    def frames(self) -> Iterator[Frame]:
        """Simulate realisation by realisation and yield its frames, the transient ones included.

        Yields
        ------
        Frame

        Raises
        ------
        SimulationError
            If the time stepping fails.
        """
        left = threading.Event()
        with ThreadPoolExecutor(self._threads, "creak-simulation") as pool:
            try:
                yield from self._frames(self._begin(pool, lambda: self._closed or left.is_set()))
            finally:
                left.set()
                pool.shutdown(wait=False, cancel_futures=True)

    def _frames(self, realisations: Iterator[_Begun]) -> Iterator[Frame]:
        """Yield the frames of realisations, of which some are always under way while one is taken."""
        run = self.run
        sigma: Real | None = None
        due = time.monotonic()
        index = 0
        ahead = deque(islice(realisations, AHEAD))
        while ahead:
            begun = ahead.popleft()
            chosen = begun.chosen.result()
            self.resolution = None if chosen is None else chosen.resolution
            simulated = [future.result() for future in begun.responses]
            responses = np.array([response for response in simulated if response is not None])
            if len(responses) < run.rig.q or self._closed:
                return
            ahead.extend(islice(realisations, 1))
            if sigma is None:
                sigma = self._noise_level(responses)
            rng = np.random.default_rng(np.random.SeedSequence((self._seed, begun.index, SENSOR_NOISE)))
            for experiment in range(run.rig.q):
                for period in range(run.periods):
                    y = responses[experiment, period]
                    y = y + sigma[:, None] * rng.standard_normal(y.shape)
                    due = self._wait(due)
                    if self._closed:
                        return
                    at = run.start + round(index * run.rig.period_ns)
                    yield Frame(begun.index, experiment, period, at, begun.inputs[experiment], y)
                    index += 1

    def _begin(self, pool: ThreadPoolExecutor, stopped: Callable[[], bool]) -> Iterator[_Begun]:
        """Hand realisation by realisation to the pool."""
        run = self.run
        system: System | None = None
        chosen: Future[_Chosen | None]
        for m in count() if self._realisations is None else range(self._realisations):
            inputs = multisine(run.rig, self._rms, self._seed, m)
            if self._system(m) is not system:
                system = self._system(m)
                chosen = pool.submit(self._choose, system, inputs[0], stopped)
            simulate = partial(self._simulate, chosen, stopped)
            yield _Begun(m, inputs, chosen, tuple(pool.submit(simulate, u) for u in inputs))

    def _system(self, m: int) -> System:
        """Return the system that acts in realisation m."""
        return [system for begin, system in self._systems if begin <= m][-1]

    def _choose(self, system: System, u: Real, stopped: Callable[[], bool]) -> _Chosen | None:
        """Choose the steps a sample, coarse and fine, or take those given; None if stopped meanwhile."""
        rig = self.run.rig
        unseen = replace(system, sensors=())  # sensors act on what is extrapolated
        if self._substeps is not None:
            return _Chosen((Stepper(unseen, rig.sample_rate, self._substeps, rig.hold),), system.sensors, None)
        noise_db = None if self._snr_db is None else -self._snr_db
        resolution = choose_substeps(
            system, rig.sample_rate, rig.hold, u, rig.transient_periods + 1, noise_db, stopped
        )
        if resolution is None:
            return None
        coarse = max(1, resolution.substeps // 2)
        steppers = tuple(Stepper(unseen, rig.sample_rate, steps, rig.hold) for steps in (coarse, 2 * coarse))
        return _Chosen(steppers, system.sensors, resolution)

    def _simulate(self, choice: Future[_Chosen | None], stopped: Callable[[], bool], u: Real) -> Real | None:
        """One experiment with inputs ``(q, N)``: its responses ``(periods, n, N)``; None if stopped meanwhile.

        The choice was handed to the pool before, so it is made or being made while this waits for it.
        """
        rig = self.run.rig
        chosen = choice.result()
        if chosen is None:
            return None
        out = np.empty((self.run.periods, rig.n, rig.period_samples))
        periods = (stepper.experiment(u, self.run.periods) for stepper in chosen.steppers)
        for period, motions in enumerate(zip(*periods, strict=True)):
            y = motions[0] if len(motions) == 1 else (4 * motions[1] - motions[0]) / 3
            for node, sensors in enumerate(chosen.sensors):
                for sensor in sensors:
                    y[node], _ = sensor.apply(y[node], rig.sample_rate)
            out[period] = y
            if stopped():
                return None
        return out

    def _noise_level(self, responses: Real) -> Real:
        """Give the standard deviation of the noise at every node."""
        if self._snr_db is None:
            return np.zeros(self.run.rig.n)
        steady = responses[:, self.run.rig.transient_periods :]
        return np.asarray(np.sqrt(np.mean(steady**2, axis=(0, 1, 3))) * 10 ** (-self._snr_db / 20))

    def _wait(self, due: float) -> float:
        """Wait until a period's last sample would have been taken; return when that was.

        A simulation that has fallen behind does not rush to catch up: the next period counts from now.
        """
        left = self.run.rig.period_samples / self.run.rig.sample_rate
        begun = due
        with self._wake:
            while not self._closed and self._pace is not None:
                now = time.monotonic()
                pace = self._pace
                if now - begun >= left / pace:
                    return max(begun + left / pace, now - 0.1)
                self._wake.wait(left / pace - (now - begun))
                left -= (time.monotonic() - begun) * pace
                begun = time.monotonic()
        return time.monotonic()


def _check(key: str, value: object, allowed: bool, rule: str) -> None:
    if not allowed:
        raise ConfigurationError("simulated rig", key, f"{value!r}, must be {rule}")


def _check_pace(pace: float | None) -> None:
    _check("pace", pace, pace is None or 0 < pace < math.inf, "finite and greater than 0")
