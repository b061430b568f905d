"""The diagnosis as a whole: `diagnose` and `validate`, the two entries to this package."""

from collections.abc import Callable

from creak.gap.periodic import PeriodicData
from creak.gap.records import Diagnosis, Validation
from creak.mechanics.system import Model
from creak.records import Rig

Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction done, 0 to 1."""


def diagnose(rig: Rig, model: Model, data: PeriodicData, progress: Progress = lambda what, done: None) -> Diagnosis:
    """Find where a recording departs from a model, which effect causes it, and how far it shrinks.

    Parameters
    ----------
    rig : Rig
    model : Model
        Kinds lumped, matrices and beam.
    data : PeriodicData
        The recording's complete realisations, see `creak.gap.periodic.gather`.
    progress : callable

    Returns
    -------
    Diagnosis

    Raises
    ------
    ConfigurationError
        If the model does not fit the rig or is unstable.
    MeasurementError
        If the recording has no complete realisation, or one period, which leaves the noise unknown.
    """
    raise NotImplementedError


def validate(rig: Rig, diagnosis: Diagnosis, other: PeriodicData) -> Validation:
    """See whether a corrected model holds in another recording, at best at another amplitude."""
    raise NotImplementedError
