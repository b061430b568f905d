"""Samples with counters in, whole period frames out; says what was lost.

A companion to a loop that its caller owns: it is pushed blocks of samples and hands back what has become
complete. The counter of a sample counts from the start of the run, so it alone says where a sample belongs:
realisation, experiment, period and place in the period. Nothing is inferred from the time of arrival.
"""

from collections.abc import Iterator

import numpy as np

from creak.records import Fault, FaultKind, Frame, Real, Run


class PeriodCutter:
    """Cuts a stream of counted samples into period frames.

    Blocks come in rising order of their counters. A gap in the counter costs every period that it touches,
    and no other; samples that were delivered already are dropped and named.

    Parameters
    ----------
    run : Run
        Fixes N, q, n and the periods of an experiment.
    """

    def __init__(self, run: Run) -> None:
        rig = run.rig
        self._run = run
        self._size = rig.period_samples
        self._u = np.empty((rig.q, self._size))
        self._y = np.empty((rig.n, self._size))
        self._next = 0  # counter of the sample that should come next
        self._whole = True  # whether the open period has had all its samples so far

    @property
    def next_counter(self) -> int:
        """Counter of the sample that should come next."""
        return self._next

    def push(self, counter: int, u: Real, y: Real) -> Iterator[Frame | Fault]:
        """Take a block of consecutive samples and yield what became complete.

        Parameters
        ----------
        counter : int
            Counter of the block's first sample.
        u : array, (q, any)
        y : array, (n, any)

        Yields
        ------
        Frame or Fault
            Frames own their samples. A fault ``lost`` names each period that a gap touched, a fault ``doubled``
            the samples that came again.
        """
        if counter < self._next:
            repeated = min(self._next - counter, u.shape[1])
            yield Fault(
                kind=FaultKind.DOUBLED,
                time=self.time_of(counter),
                message=f"samples {counter} to {counter + repeated - 1} came a second time; the first ones count",
            )
            counter, u, y = counter + repeated, u[:, repeated:], y[:, repeated:]
            if u.shape[1] == 0:
                return
        if counter > self._next:
            yield from self._skip(counter)
        while u.shape[1]:
            at = self._next % self._size
            taken = min(self._size - at, u.shape[1])
            self._u[:, at : at + taken] = u[:, :taken]
            self._y[:, at : at + taken] = y[:, :taken]
            self._next += taken
            u, y = u[:, taken:], y[:, taken:]
            if self._next % self._size == 0:
                if self._whole:
                    yield self._frame(self._next // self._size - 1)
                self._whole = True

    def _skip(self, counter: int) -> Iterator[Fault]:
        """Lose the samples from the expected counter up to, not including, the given one."""
        first_lost, last_lost = self._next, counter - 1
        for index in range(first_lost // self._size, last_lost // self._size + 1):
            if index > first_lost // self._size or self._whole:  # a period is lost once
                m, c, p = self._place(index)
                yield Fault(
                    kind=FaultKind.LOST,
                    time=self.time_of(index * self._size),
                    message=f"samples {first_lost} to {last_lost} never came; "
                    f"period {p} of experiment {c} of realisation {m} is lost",
                    realisation=m,
                    experiment=c,
                    period=p,
                )
        self._next = counter
        self._whole = counter % self._size == 0

    def time_of(self, counter: int) -> int:
        """Recorded time of a sample, ns since the Unix epoch."""
        return self._run.start + round(counter * 1e9 / self._run.rig.sample_rate)

    def _place(self, index: int) -> tuple[int, int, int]:
        experiment, period = divmod(index, self._run.periods)
        realisation, experiment = divmod(experiment, self._run.rig.q)
        return realisation, experiment, period

    def _frame(self, index: int) -> Frame:
        m, c, p = self._place(index)
        return Frame(m, c, p, self.time_of(index * self._size), self._u.copy(), self._y.copy())
