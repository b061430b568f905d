"""What is fitted to what: a rig, a model, a recording, and how the model is simulated on it."""

import math
from dataclasses import dataclass

import numpy as np

from creak.gap.hypothesis import Hypothesis, apply
from creak.gap.periodic import PeriodicData
from creak.gap.regression import Indices
from creak.gap.view import lines_of
from creak.mechanics.effects import Clearance, CoulombFriction, Hysteresis, OneSidedStop
from creak.mechanics.steady import SteadyState, simulate_steady
from creak.mechanics.system import Model, System, assemble
from creak.records import Complex, Real, Rig

_POINTS = (((CoulombFriction, Hysteresis), 16384), ((Clearance, OneSidedStop), 8192))
"""Points a period that a law needs; the others are smooth and do with 4096."""

TOLERANCE = 1e-6
"""Of the steady state while hypotheses compete."""


@dataclass(frozen=True, eq=False)
class Setting:
    """What is fitted to what.

    Parameters
    ----------
    rig, model, data : Rig, Model, PeriodicData
    top : int
        Lines that count, from DC on.
    """

    rig: Rig
    model: Model
    data: PeriodicData
    top: int

    def system(self, hypothesis: Hypothesis) -> System:
        """Assemble the model with a hypothesis in it."""
        return assemble(apply(self.model, hypothesis), self.rig)

    def simulate(
        self,
        hypothesis: Hypothesis,
        experiments: Indices,
        guess: Real | None = None,
        oversampling: int | None = None,
        tolerance: float = TOLERANCE,
    ) -> SteadyState:
        """Steady state of experiments."""
        return simulate_steady(
            self.system(hypothesis),
            self.data.u[experiments],
            self.rig.sample_rate,
            self.rig.hold,
            guess=guess,
            oversampling=oversampling or self.samples_a_sample(hypothesis),
            tolerance=tolerance,
        )

    def samples_a_sample(self, hypothesis: Hypothesis) -> int:
        """Samples of the elements a sample of the rig, so that folded harmonics lie below usual noise."""
        elements = self.system(hypothesis).elements
        if not elements:
            return 1
        wanted = max(next((size for kinds, size in _POINTS if isinstance(e, kinds)), 4096) for e in elements)
        return 1 << max(0, math.ceil(math.log2(wanted / self.rig.period_samples)))

    def residual(self, y: Real, experiments: Indices, top: int | None) -> Complex:
        """Whitened difference of simulated and measured motion, ``(E, top, n)``."""
        Y = lines_of(y)[:, :top]
        mean = self.data.Y[experiments][:, :top]
        return np.asarray((Y - mean) / np.sqrt(self.data.variance[:top]))
