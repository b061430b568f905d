"""A source whose transients are estimated and taken off: the local polynomial method before the pipeline."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from creak.detection import detection_lines
from creak.errors import MeasurementError
from creak.localpolynomial import settled
from creak.records import Fault, Frame, FrameStatus, Real, Run
from creak.sources.protocol import Source


@dataclass
class _Gathered:
    """Frames of the realisation that is being filled."""

    index: int
    frames: dict[tuple[int, int], Frame] = field(default_factory=dict)
    refused: list[Frame] = field(default_factory=list)  # doubled or damaged ones, for the monitor to name
    late: list[Frame] = field(default_factory=list)  # of earlier realisations, likewise


class SettledSource:
    """All periods of another source, the transient ones included, as steady ones.

    Its run has no transient periods. A realisation whose frames are all there and finite leaves as frames that
    hold, at the excited lines and the detection lines, the response without its transient; the others leave as
    they came, and the monitor names what is missing.

    Parameters
    ----------
    source : Source
        Of experiments of at least two periods; one that may be held back.

    Raises
    ------
    MeasurementError
        If the run has too few periods or lines.
    """

    live = False

    def __init__(self, source: Source) -> None:
        self._source = source
        run = source.run
        if run.periods < 2:
            raise MeasurementError(f"{run.rig.name}: experiments of {run.periods} period; the method needs two")
        self._lines = tuple(sorted(run.rig.lines + detection_lines(run.rig).all))
        rig = replace(run.rig, transient_periods=0)
        self.run: Run = replace(run, rig=rig, steady_periods=run.periods)

    def frames(self) -> Iterator[Frame | Fault]:
        """Yield realisations as they become complete, and what the source reports in between."""
        held: _Gathered | None = None
        for item in self._source.frames():
            if isinstance(item, Fault):
                yield item
                continue
            if not self._planned(item):
                yield item
                continue
            if held is None or item.realisation > held.index:
                if held is not None:
                    yield from self._let_go(held)
                held = _Gathered(item.realisation)
            if item.realisation < held.index:
                held.late.append(item)
                continue
            place = (item.experiment, item.period)
            if place in held.frames or not self._usable(item):
                held.refused.append(item)
            else:
                held.frames[place] = item
        if held is not None:
            yield from self._let_go(held)

    def close(self) -> None:
        """End the iteration soon."""
        self._source.close()

    def _planned(self, frame: Frame) -> bool:
        return (
            frame.realisation >= 0
            and 0 <= frame.experiment < self.run.rig.q
            and 0 <= frame.period < self.run.periods
        )

    def _usable(self, frame: Frame) -> bool:
        rig = self.run.rig
        if (frame.u.shape, frame.y.shape) != ((rig.q, rig.period_samples), (rig.n, rig.period_samples)):
            return False
        return bool(np.isfinite(frame.u).all() and np.isfinite(frame.y).all())

    def _let_go(self, held: _Gathered) -> Iterator[Frame | Fault]:
        run, rig = self.run, self.run.rig
        yield from held.refused
        places = [(c, p) for c in range(rig.q) for p in range(run.periods)]
        if any(place not in held.frames for place in places):
            yield from (held.frames[place] for place in places if place in held.frames)
            yield from held.late  # last, when the monitor has turned to this realisation and takes no more of them
            return
        records = np.stack([self._record(held, c) for c in range(rig.q)])
        spectra = settled(records, run.periods, self._lines)  # (q, P, lines, channels)
        full = np.zeros((*spectra.shape[:2], rig.q + rig.n, rig.period_samples // 2 + 1), dtype=np.complex128)
        full[..., list(self._lines)] = spectra.swapaxes(2, 3)
        samples = np.fft.irfft(full * rig.period_samples, n=rig.period_samples)
        for c, p in places:
            u, y = samples[c, p, : rig.q], samples[c, p, rig.q :]
            yield replace(held.frames[c, p], u=u, y=y, status=FrameStatus.ACCEPTED, reason="")
        yield from held.late

    def _record(self, held: _Gathered, experiment: int) -> Real:
        frames = [held.frames[experiment, p] for p in range(self.run.periods)]
        return np.concatenate([np.concatenate((frame.u, frame.y)) for frame in frames], axis=1)
