"""What the checks need from the frames of a realisation, and their findings as faults."""

from dataclasses import dataclass

import numpy as np

from creak.multisine import planned_spectra
from creak.quality.checks import (
    Clipping,
    clipping,
    longest_hold,
    orthogonality_loss_db,
    period_drift,
    transient_share,
    unremarkable,
    wrong_inputs,
)
from creak.realisations import Realisation, spectrum
from creak.records import Complex, Fault, FaultKind, Frame, FrameStatus, Run

FLAWS = frozenset(
    {
        FaultKind.TRANSIENT,
        FaultKind.DRIFT,
        FaultKind.CLIPPED,
        FaultKind.STUCK,
        FaultKind.WRONG_INPUT,
        FaultKind.NOT_ORTHOGONAL,
    }
)
"""Kinds of faults that flag data which enter the sums all the same."""


@dataclass(frozen=True)
class Flaw:
    """A finding about a realisation.

    Parameters
    ----------
    fault : Fault
        For the record, in words.
    nodes : tuple of str
        Nodes whose responses have it; empty where it is the inputs' or the whole realisation's.
    """

    fault: Fault
    nodes: tuple[str, ...] = ()


_Finding = tuple[FaultKind, str, tuple[str, ...]]


class Watch:
    """Gathers from the frames of a realisation what its checks need; memory does not grow with frames.

    Parameters
    ----------
    run : Run
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        rig = run.rig
        driven = [f"input {rig.nodes[i].name}" for i in rig.driven]
        self._channels = (*driven, *(f"response {node.name}" for node in rig.nodes))
        self._index = -1
        self._begin(-1)

    def _begin(self, index: int) -> None:
        self._index = index
        self._discarded: dict[int, Complex] = {}
        self._clipped: dict[int, list[Clipping]] = {}
        self._held: dict[int, int] = {}

    def take(self, frame: Frame) -> None:
        """Look at a frame as the collector judged it; refused ones are passed over."""
        if frame.status is FrameStatus.REJECTED:
            return
        rig = self._run.rig
        if frame.realisation < self._index:
            return  # a late copy of a transient frame: the open realisation is not over for it
        if frame.realisation > self._index:
            self._begin(frame.realisation)
        if (frame.u.shape, frame.y.shape) != ((rig.q, rig.period_samples), (rig.n, rig.period_samples)):
            return
        if frame.status is FrameStatus.TRANSIENT:
            if frame.period == rig.transient_periods - 1:
                with np.errstate(invalid="ignore", over="ignore"):
                    responses = spectrum(rig, frame.u[:0], frame.y).T
                if np.isfinite(responses).all():  # a sample that is not finite leaves no line finite
                    self._discarded[frame.experiment] = responses
            return
        for channel, x in enumerate((*frame.u, *frame.y)):
            if unremarkable(np.ascontiguousarray(x, dtype=np.float64)):
                continue
            hold = longest_hold(x)
            found = clipping(x)
            if found is not None:
                self._clipped.setdefault(channel, []).append(found)
            elif hold > rig.period_samples / 8 and (channel >= rig.q or x.any()):
                # An input may be at rest in an experiment that drives the others.
                self._held[channel] = max(hold, self._held.get(channel, 0))

    def judge(self, realisation: Realisation) -> tuple[Flaw, ...]:
        """Give the findings about a complete realisation, whose frames were all taken."""
        if realisation.index != self._index:
            self._begin(realisation.index)
        inputs = realisation.spectra[..., : self._run.rig.q].swapaxes(2, 3).mean(axis=1)  # (experiment, input, F)
        findings = [
            *self._pinned(),
            *self._wrong_inputs(realisation, inputs),
            *self._not_orthogonal(inputs),
            *self._not_periodic(realisation),
        ]
        self._begin(-1)
        index, end = realisation.index, realisation.end
        return tuple(
            Flaw(Fault(kind, end, f"realisation {index}: {text}", index), nodes) for kind, text, nodes in findings
        )

    def _pinned(self) -> list[_Finding]:
        findings: list[_Finding] = []
        frames = self._run.rig.q * self._run.steady_periods
        for channel, found in sorted(self._clipped.items()):
            worst = max(found, key=lambda one: one.share)
            findings.append(
                (
                    FaultKind.CLIPPED,
                    f"{self._channels[channel]} is clipped at {worst.limit:.4g} in {len(found)} of {frames} "
                    f"periods, up to {100 * worst.share:.2g} % of the samples",
                    self._responding(channel),
                )
            )
        for channel, hold in sorted(self._held.items()):
            text = f"{self._channels[channel]} does not change for {hold} samples of a period"
            findings.append((FaultKind.STUCK, text, self._responding(channel)))
        return findings

    def _responding(self, channel: int) -> tuple[str, ...]:
        """Name of the node whose response a channel is; empty for an input."""
        rig = self._run.rig
        return (rig.nodes[channel - rig.q].name,) if channel >= rig.q else ()

    def _wrong_inputs(self, realisation: Realisation, inputs: Complex) -> list[_Finding]:
        run, rig = self._run, self._run.rig
        plan = run.excitation
        if plan.kind != "multisine" or plan.rms is None or plan.seed is None:
            return []
        planned = planned_spectra(rig, plan.rms, plan.seed, realisation.index)
        wrong = wrong_inputs(inputs, planned, rig.lines, rig.period_samples, self._channels)
        return [(FaultKind.WRONG_INPUT, wrong, ())] if wrong else []

    def _not_orthogonal(self, inputs: Complex) -> list[_Finding]:
        loss = orthogonality_loss_db(inputs.transpose(2, 1, 0))
        if not loss > 1.0:
            return []
        text = f"the experiments are not orthogonal; the response matrix has {loss:.1f} dB more noise for it"
        return [(FaultKind.NOT_ORTHOGONAL, text, ())]

    def _not_periodic(self, realisation: Realisation) -> list[_Finding]:
        rig = self._run.rig
        # Beside detection lines the excited ones do not lie side by side: they are copied once for all checks.
        spectra = np.ascontiguousarray(realisation.spectra.swapaxes(2, 3)).swapaxes(2, 3)
        drift = period_drift(spectra, rig.lines, rig.period_samples)
        if drift is not None:
            text = f"{drift.described(rig.period_samples)}: that explains {100 * drift.share:.0f} % of the change"
            return [(FaultKind.DRIFT, f"{text} from period to period", ())]
        before = None
        if len(self._discarded) == rig.q:
            before = np.stack([self._discarded[c] for c in range(rig.q)], axis=1)  # (n, q, F)
        if spectra.shape[1] + (before is not None) < 3:
            return []
        shares = [transient_share(spectra, rig.q + i, None if before is None else before[i]) for i in range(rig.n)]
        known = [share or 0.0 for share in shares]
        worst = int(np.argmax(known))
        if not known[worst]:
            return []
        text = (
            "the transient, or a drift, has not died out in the first kept period: "
            f"{10 * np.log10(known[worst]):.1f} dB of the response at node {rig.nodes[worst].name}"
        )
        return [(FaultKind.TRANSIENT, text, tuple(rig.nodes[i].name for i in range(rig.n) if known[i]))]
