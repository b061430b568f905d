"""Data quality before statistics: what is wrong with frames that are whole and finite.

Each check is a pure function that says what it found and how large it is; :class:`Watch` collects what they need
from the frames of a realisation and turns the findings into faults. A finding flags the data; it does not keep
them out of the sums, since only a person can say whether levels with a known flaw are better than none.
"""

from creak.quality.checks import (
    clipping,
    longest_hold,
    match_input,
    orthogonality_loss_db,
    period_drift,
    transient_share,
    wrong_inputs,
)
from creak.quality.watch import FLAWS, Flaw, Watch

__all__ = [
    "FLAWS",
    "Flaw",
    "Watch",
    "clipping",
    "longest_hold",
    "match_input",
    "orthogonality_loss_db",
    "period_drift",
    "transient_share",
    "wrong_inputs",
]
