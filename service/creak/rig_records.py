"""Records of what is measured: a rig and its nodes. :mod:`creak.records` hands them on, with its conventions."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Grid = Literal["full", "odd", "random-odd"]
Hold = Literal["band-limited", "zero-order"]


@dataclass(frozen=True)
class Node:
    """A measured point of the structure.

    Parameters
    ----------
    name : str
        Its name, unique in the rig.
    output : str
        Unit of the response.
    input : str or None
        Unit of the force or current that drives the node; None where it is not driven.
    """

    name: str
    output: str
    input: str | None = None


@dataclass(frozen=True)
class Rig:
    """What is measured: nodes, sampling and excited lines (the file ``rig.toml``).

    Parameters
    ----------
    name : str
    sample_rate : float
        Samples a second, Hz.
    period_samples : int
        Samples a period, N.
    transient_periods : int
        Periods dropped at the start of every experiment.
    lines : tuple of int
        Excited lines as multiples of ``sample_rate / period_samples``, rising.
    nodes : tuple of Node
    grid, hold : str
        Line grid, and what the input does between samples.
    network : tuple of pairs of str, or None
        Given edges between nodes; None for a dense network.
    """

    name: str
    sample_rate: float
    period_samples: int
    transient_periods: int
    lines: tuple[int, ...]
    nodes: tuple[Node, ...]
    grid: Grid = "full"
    hold: Hold = "band-limited"
    network: tuple[tuple[str, str], ...] | None = None

    @property
    def n(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def q(self) -> int:
        """Number of inputs (driven nodes), which is also the number of experiments a realisation."""
        return sum(node.input is not None for node in self.nodes)

    @property
    def driven(self) -> tuple[int, ...]:
        """Indices of the driven nodes, in the order of the inputs."""
        return tuple(i for i, node in enumerate(self.nodes) if node.input is not None)

    @property
    def square(self) -> bool:
        """True if every node is driven, so that networked levels can exist."""
        return self.q == self.n

    @property
    def frequencies(self) -> NDArray[np.float64]:
        """Frequencies of the excited lines, Hz, ``(F,)``."""
        return np.asarray(self.lines, dtype=np.float64) * (self.sample_rate / self.period_samples)

    @property
    def period_ns(self) -> float:
        """Length of a period in nanoseconds."""
        return 1e9 * self.period_samples / self.sample_rate
