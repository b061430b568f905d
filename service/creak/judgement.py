"""All that is kept of realisations, and all that is said from it: levels, detection lines, remarks."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from creak.detection import LineSums, detection_levels
from creak.edges import edge_remarks, edge_tests, reference
from creak.network import estimate
from creak.realisations import Realisation
from creak.records import Complex, Estimate, Rig, Scope
from creak.statistics import Sums


@dataclass(frozen=True, eq=False)
class Block:
    """Sums of complete realisations; blocks add, in any order.

    Parameters
    ----------
    sums : Sums
        At the excited lines.
    excited, left_out : LineSums
        Powers of the responses at the excited lines and at the detection lines; both empty where the grid leaves
        no lines out, as nothing is to be compared then.
    """

    sums: Sums
    excited: LineSums
    left_out: LineSums

    @classmethod
    def of(cls, realisation: Realisation, inputs: int) -> "Block":
        """Sums of one realisation."""
        left_out = realisation.left_out
        excited = realisation.spectra if left_out.size else left_out
        return cls(
            sums=Sums.of(realisation.spectra, inputs, realisation.S),
            excited=LineSums.of(excited[..., inputs:]),
            left_out=LineSums.of(left_out[..., inputs:]),
        )

    def __add__(self, other: "Block") -> "Block":
        """Sums of both operands' realisations together."""
        excited = self.excited + other.excited if self.left_out.mean.size else self.excited
        return Block(self.sums + other.sums, excited, self.left_out + other.left_out)

    def about(self, about: Complex) -> "Block":
        """Express the same with residuals about another matrix, ``(F, n, q)``."""
        return replace(self, sums=self.sums.moved(about))


class Last(Protocol):
    """What an estimate has to know of the last realisation in it: its index, and the recorded time of its end."""

    @property
    def index(self) -> int: ...  # noqa: D102 - as the class says
    @property
    def end(self) -> int: ...  # noqa: D102


def judged(rig: Rig, block: Block, scope: Scope, last: Last) -> Estimate:
    """Estimate from a block, with detection lines, the test of given edges, and remarks.

    Parameters
    ----------
    rig : Rig
    block : Block
    scope : Scope
    last : Last
        The last realisation in the block.
    """
    chosen = reference(block.sums, tuple(node.name for node in rig.nodes))
    levels = estimate(rig, chosen.sums, scope, last.end, last.index)
    remarks = chosen.remarks
    if levels.located and scope is Scope.RUN:
        try:
            remarks += edge_remarks(edge_tests(rig, block.sums))
        except np.linalg.LinAlgError:
            remarks += ("the given edges cannot be tested: the response matrix is singular",)
    return replace(levels, detection=detection_levels(rig, block.excited, block.left_out), remarks=remarks)
