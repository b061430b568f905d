"""Parts of the records: what can go wrong with data, and what the detection lines say.

They lie below :mod:`creak.records`, whose records carry them.
"""

from dataclasses import dataclass
from enum import StrEnum


class FaultKind(StrEnum):
    """What can go wrong with data."""

    LOST = "lost"  # samples or frames that never came
    NOT_FINITE = "not-finite"
    WRONG_SHAPE = "wrong-shape"
    DOUBLED = "doubled"
    LATE = "late"  # a frame of a realisation that is closed already
    OUT_OF_PLAN = "out-of-plan"  # an experiment or a period that the run does not have
    INCOMPLETE = "incomplete"  # a realisation that closed with experiments missing
    SINGULAR = "singular"  # a realisation whose input matrix cannot be inverted
    DAMAGED = "damaged"  # a part of a recording that cannot be read
    STORAGE = "storage"  # the disk is full
    TRANSIENT = "transient"  # what was discarded has not died out in what is kept
    DRIFT = "drift"  # the period is not that of the rig
    CLIPPED = "clipped"
    STUCK = "stuck"  # a channel that does not move
    WRONG_INPUT = "wrong-input"  # other than the excitation says
    NOT_ORTHOGONAL = "not-orthogonal"  # experiments that resemble each other
    CORRUPTED = "corrupted"  # a frame of a bus that is too short or has a wrong checksum
    RESTARTED = "restarted"  # a controller that began again
    SILENT = "silent"  # a rig that sends nothing
    BUS_ERROR = "bus-error"  # error frames on a bus
    BUS_OFF = "bus-off"  # a bus with too many errors, which its interface has left
    DISCONNECTED = "disconnected"  # an interface that cannot be read


@dataclass(frozen=True)
class DetectionLevel:
    """Distortion of one node as the lines show it that are not excited.

    Levels are mean powers of a line, ``10 log10`` of ``|Y|^2`` of the period mean less its noise, dB re 1 unit
    squared; None where there are no such lines, or where nothing stands above the noise.

    Parameters
    ----------
    name : str
        Of the node.
    excited_db : float or None
        Mean power of an excited line, to compare with.
    odd_db, even_db : float or None
        Mean power of an odd, of an even line that is left out.
    noise_db : float or None
        Mean noise power of a period mean at the lines left out; None for one period.
    """

    name: str
    excited_db: float | None
    odd_db: float | None
    even_db: float | None
    noise_db: float | None
