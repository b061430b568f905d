"""What an estimate says beside its levels: records of the detection lines.

They lie below :mod:`creak.records`, which holds the estimate that carries them.
"""

from dataclasses import dataclass


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
