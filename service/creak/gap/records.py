"""What a diagnosis says, frozen. Levels are dB of a power ratio, ``10 log10``; everything else is SI."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, Literal

from creak.mechanics.system import Model
from creak.records import Real

Pattern = Literal["ground", "edge", "actuator", "sensor"]
"""How the missing force spreads over the nodes: node to ground, between two nodes, at an input, at a response."""


CLOSED: Final = 0.995
"""Share of a gap that is closed at least where it is closed to noise."""
WITHIN_DB: Final = 1.0
"""Above noise, at most, where a gap is closed to it."""


class Verdict(StrEnum):
    """How a diagnosis ends; the rules stand in `creak.gap.verdict`."""

    NO_GAP = "no_gap"
    EXPLAINED = "explained"
    PARTLY_EXPLAINED = "partly_explained"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class GapLevels:
    """Power of measured minus simulated over that of measured, mean over the nodes, on realisations kept aside.

    Parameters
    ----------
    before_db, after_db, noise_db : float
        With the model as it was, as corrected, and what noise alone leaves.
    closed : float or None
        ``1 - (after - noise)/(before - noise)`` in power, within [0, 1]; None without a gap.
    """

    before_db: float
    after_db: float
    noise_db: float
    closed: float | None

    @property
    def closes(self) -> bool:
        """Whether it is closed to noise."""
        return (self.closed or 0.0) >= CLOSED and self.after_db <= self.noise_db + WITHIN_DB


@dataclass(frozen=True)
class NodeGap:
    """The same at one node, and how its gap before divides.

    Parameters
    ----------
    name : str
    before_db, after_db, noise_db : float
    linear_share, nonlinear_share, noise_share : float
        Shares of the gap's power: coherent with the inputs, not coherent, noise; their sum is 1.
    """

    name: str
    before_db: float
    after_db: float
    noise_db: float
    linear_share: float
    nonlinear_share: float
    noise_share: float


@dataclass(frozen=True)
class BandShare:
    """How the gap of one node divides in one band.

    Parameters
    ----------
    node : str
    band_hz : tuple of float
    gap_db : float
        The band's gap relative to the node's measured power over all lines.
    linear_share, nonlinear_share, noise_share : float
        As in `NodeGap`.
    linear_error, nonlinear_error, noise_error : float
        Their standard errors.
    """

    node: str
    band_hz: tuple[float, float]
    gap_db: float
    linear_share: float
    nonlinear_share: float
    noise_share: float
    linear_error: float
    nonlinear_error: float
    noise_error: float


@dataclass(frozen=True)
class MissingForce:
    """A place at which the missing force acts.

    Parameters
    ----------
    at : tuple of str
        Two nodes, a node and ``ground``, or one node (actuator or sensor).
    share : float
        Of the power of the gap above noise that a free force at this place takes up.
    band_hz : tuple of float
        Holds 90 % of the missing force's power.
    pattern : str
    residual : float
        Whitened power that a free force here leaves, relative to noise: 1 at the right place.
    position, position_error : float or None
        Along a beam and its standard error, m, where the place lies between sensors.
    """

    at: tuple[str, ...]
    share: float
    band_hz: tuple[float, float]
    pattern: Pattern
    residual: float
    position: float | None = None
    position_error: float | None = None


@dataclass(frozen=True)
class Cause:
    """An effect that closes the gap, or part of it.

    Parameters
    ----------
    effect : str
        Name in the vocabulary.
    at : tuple of str
    parameters, standard_errors : mapping of str to float
        By parameter name; a standard error is NaN where the data hold none.
    probability : float
        Posterior over the vocabulary, ``unknown`` included.
    gap_after_db : float
        Gap when this effect and those before it are in the model.
    before : mapping of str to float or None
        Parameters that the model gave to this effect, if it had it; None for a missing effect.
    instead_of : int or None
        For an alternative: index of the cause that it would replace.
    """

    effect: str
    at: tuple[str, ...]
    parameters: Mapping[str, float]
    standard_errors: Mapping[str, float]
    probability: float
    gap_after_db: float
    before: Mapping[str, float] | None = None
    instead_of: int | None = None


@dataclass(frozen=True)
class LinearCorrection:
    """A mass, stiffness or damping of the model that had to move.

    Parameters
    ----------
    element : str
        As the model names it: ``1`` for a mass, ``1-2`` or ``ground-1`` for a link.
    parameter : str
        ``mass``, ``stiffness`` or ``damping``.
    before, after : float
    standard_error : float
    """

    element: str
    parameter: str
    before: float
    after: float
    standard_error: float


@dataclass(frozen=True, eq=False)
class ForceCurve:
    """The missing force as measured at one place, and the fitted law over it.

    Parameters
    ----------
    at : tuple of str
    displacement, velocity, force : array, (K,)
        Samples of one experiment, thinned: m, m/s, N.
    fitted : array, (K,), or None
        Force of the diagnosed causes at this place for the same motion; None if none was named.
    """

    at: tuple[str, ...]
    displacement: Real
    velocity: Real
    force: Real
    fitted: Real | None


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Everything that a diagnosis says.

    Parameters
    ----------
    verdict : Verdict
    gap : GapLevels
    nodes : tuple of NodeGap
    where : tuple of MissingForce
        In falling share.
    causes : tuple of Cause
        In the order in which they were added: the waterfall.
    alternatives : tuple of Cause
        That the data cannot tell from a cause; each with `instead_of`.
    linear_corrections : tuple of LinearCorrection
    held_out_realisations : int
        Realisations that no fit has seen.
    bands : tuple of BandShare
    curves : tuple of ForceCurve
    unknown_probability : float
        Posterior that the effect is none of the vocabulary.
    tested : tuple of str
        Effects that were tried.
    not_claimed : tuple of str
        What was not tested or cannot be said, a sentence each.
    corrected : Model
        The model with causes and corrections in it; the model itself if there is none.
    """

    verdict: Verdict
    gap: GapLevels
    nodes: tuple[NodeGap, ...]
    where: tuple[MissingForce, ...]
    causes: tuple[Cause, ...]
    alternatives: tuple[Cause, ...]
    linear_corrections: tuple[LinearCorrection, ...]
    held_out_realisations: int
    bands: tuple[BandShare, ...]
    curves: tuple[ForceCurve, ...]
    unknown_probability: float
    corrected: Model
    tested: tuple[str, ...] = ()
    not_claimed: tuple[str, ...] = ()


@dataclass(frozen=True)
class Validation:
    """How far the corrected model holds in another recording.

    Parameters
    ----------
    holds : bool
        The gap is closed there too.
    gap : GapLevels
    nodes : tuple of NodeGap
    refitted : mapping of str to float
        Parameters of the causes (``effect at place: parameter``) fitted anew to the other recording.
    conclusion : str
        One sentence: of the right kind, or a stand-in.
    """

    holds: bool
    gap: GapLevels
    nodes: tuple[NodeGap, ...]
    refitted: Mapping[str, float] = field(default_factory=dict)
    conclusion: str = ""
