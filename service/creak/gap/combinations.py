"""Every two or three laws at some places, at every inner parameter of their grids, from one matrix of products.

Laws whose inner parameters were found one at a time may fit badly together and be right: beside a saturation the
best dead zone of its actuator is none, and a gain takes its place. All that least squares needs of two columns is
their product, so one Gram matrix of all laws at all points of their grids tells what every two of them leave, and
with one law eliminated what every three do; the best are then optimised from where the grids have them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import Final

import numpy as np
from numpy.typing import NDArray

from creak.gap.candidates import Candidate, candidates_at
from creak.gap.regression import LINEAR, Indices
from creak.gap.scan import Place, Scan, Trial
from creak.gap.several import Set, jointly, rest, turn
from creak.mechanics.effects import Resonator
from creak.mechanics.electronics import SensorQuantisation
from creak.mechanics.steady import Each
from creak.records import Complex, Real

_ONCE = 4  # combinations that are given one turn of their inner parameters, for every one that is given more
_TOO_FINE: Final = (Resonator, SensorQuantisation)
_LOST = 1e-8  # share of a column beyond the others, below which it is theirs


@dataclass(frozen=True, eq=False)
class System:
    """Normal equations of all columns, each of which is fitted or has coefficient 1.

    Parameters
    ----------
    gram, right : array, (G, G), (G,)
    power : float
        What is there without any.
    size : array, (G,)
        Power of the columns before any was eliminated.
    fixed, positive : array of bool, (G,)
        Coefficients that are 1; those that must be positive.
    """

    gram: Real
    right: Real
    power: float
    size: Real
    fixed: NDArray[np.bool_]
    positive: NDArray[np.bool_]

    def without(self, i: int) -> "System":
        """Normal equations of the others, with column `i` among what is fitted."""
        g, r = self.gram[i], self.right
        if self.fixed[i]:
            return System(self.gram, r - g, self.power - 2 * r[i] + g[i], self.size, self.fixed, self.positive)
        own = max(g[i], 1e-300)
        gram = self.gram - np.outer(g, g) / own
        return System(gram, r - g * r[i] / own, self.power - r[i] ** 2 / own, self.size, self.fixed, self.positive)

    def pairs(self) -> tuple[Real, Real, Real]:
        """What every two columns leave, ``(G, G)``, and the coefficients of the first and of the second."""
        g, r = self.gram, self.right
        own = np.diag(g)
        usable = own > _LOST * self.size
        first = self.fixed[:, None]
        over = np.where(usable, own, np.inf)
        share = np.where(first, 1.0, g / over[:, None])  # of the first column, as the second moves it
        rest = r[None, :] - np.where(first, g, g * (r / over)[:, None])
        size = np.where(first, own[None, :], own[None, :] - g * (g / over[:, None]))
        alone = self.power - np.where(self.fixed, 2 * r - own, r**2 / over)
        clear = size > _LOST * self.size[None, :]
        fitted = np.where(clear, rest / np.where(clear, size, 1.0), 0.0)
        second = np.where(self.fixed[None, :], 1.0, fitted)
        left = alone[:, None] - 2 * second * rest + second**2 * size
        one = np.where(first, 1.0, (r / over)[:, None] - share * second)
        wrong = (self.positive[:, None] & (one <= 0)) | (self.positive[None, :] & (second <= 0))
        wrong |= ~clear | ~(usable | self.fixed)[:, None]
        return np.where(wrong, np.inf, left), one, second


class Combinations:
    """All laws at some places, at every point of their grids.

    Parameters
    ----------
    scan : Scan
    places : sequence of Place
    free : array of bool, (K,)
        Linear elements fitted beside them.
    alone : sequence of Trial
        Laws with the inner parameters that they have alone; used for those whose grids are too fine.
    """

    def __init__(
        self,
        scan: Scan,
        places: Sequence[Place],
        free: NDArray[np.bool_],
        alone: Sequence[Trial] = (),
    ) -> None:
        self.scan, self.free = scan, free
        made: list[tuple[Candidate, list[float | Real]]] = []
        for group, at in dict.fromkeys(places):
            made += [
                (candidate, [float(x) for x in candidate.grid(scan.view, scan.few)])
                for candidate in candidates_at(group, at)
                if candidate.kind not in _TOO_FINE and not (candidate.kind in LINEAR and free.any())
            ]
        made += [(item.candidate, [item.inner]) for item in alone if item.candidate.kind in _TOO_FINE]
        self.laws = [candidate for candidate, _ in made]
        self.inner = [inner for _, grid in made for inner in grid]
        self.owner = np.repeat(np.arange(len(made)), [len(grid) for _, grid in made])
        parts, fixed, positive = [], [], []
        for _, there in groupby(made, key=lambda item: (item[0].group, item[0].at)):
            phi = []
            for candidate, grid in there:
                forces = candidate.forces(scan.view, scan.few)
                for inner in grid:
                    lines, one = forces(inner)
                    phi.append(lines)
                    fixed.append(one)
                    positive.append(not one and candidate.effect(-0.5, inner) is None)
            parts.append((candidate.pattern(scan.view), np.stack(phi)))
        self.system = _system(scan, parts, free, np.array(fixed), np.array(positive))

    def best(self, size: int, most: int, each: Each = map) -> list[Set]:
        """The best sets of so many laws, each law at a place once, their inner parameters optimised.

        Parameters
        ----------
        size : int
            2 or 3.
        most : int
            Sets that are optimised to the end.
        each : callable
            What they are optimised by, as for `creak.gap.search.Search`.

        Returns
        -------
        list of tuple of Trial
            The one that leaves least first.
        """
        rough = (self._twos() if size == 2 else self._threes())[: _ONCE * most]
        tried = [self._trials(chosen) for _, chosen in rough]
        once = sorted(each(partial(turn, self.scan, free=self.free), tried), key=rest)
        return sorted(each(partial(jointly, self.scan, free=self.free), once[:most]), key=rest)

    def _twos(self) -> list[tuple[float, tuple[int, ...]]]:
        left, _, _ = self.system.pairs()
        return sorted(_by_laws(left, self.owner), key=_first)

    def _threes(self) -> list[tuple[float, tuple[int, ...]]]:
        found: dict[tuple[int, ...], tuple[float, tuple[int, ...]]] = {}
        for i in range(len(self.owner)):
            after = self.owner > self.owner[i]
            if not after.any():
                break
            more = np.flatnonzero(after)
            system = self.system.without(i)
            part = System(
                system.gram[np.ix_(more, more)],
                system.right[more],
                system.power,
                self.system.size[more],
                system.fixed[more],
                system.positive[more],
            )
            left, one, second = part.pairs()
            if self.system.positive[i]:
                g, own = self.system.gram[i], max(self.system.gram[i, i], 1e-300)
                own_share = (self.system.right[i] - g[more][:, None] * one - g[more][None, :] * second) / own
                left = np.where(own_share <= 0, np.inf, left)
            for least, (j, k) in _by_laws(left, self.owner[more]):
                chosen = i, int(more[j]), int(more[k])
                laws = tuple(int(self.owner[x]) for x in chosen)
                if laws not in found or least < found[laws][0]:
                    found[laws] = least, chosen
        return sorted(found.values(), key=_first)

    def _trials(self, chosen: Sequence[int]) -> Set:
        every = np.arange(len(self.scan.view.r))
        return tuple(
            Trial(law, inner, law.column(self.scan.view, inner, every), np.inf)
            for law, inner in ((self.laws[self.owner[i]], self.inner[i]) for i in chosen)
        )


def best_sets(
    scan: Scan, free: NDArray[np.bool_], size: int, most: int, tried: tuple[Sequence[Place], Sequence[Trial]]
) -> list[Set]:
    """`Combinations.best` of the laws at some places, given with what they leave alone: a task."""
    places, alone = tried
    return Combinations(scan, places, free, alone).best(size, most)


def _system(
    scan: Scan,
    parts: Sequence[tuple[Complex, Complex]],
    free: NDArray[np.bool_],
    fixed: NDArray[np.bool_],
    positive: NDArray[np.bool_],
) -> System:
    """Normal equations of columns given as patterns ``(L, n)`` and forces ``(G', E, L)``, on few experiments."""
    flat, right, taken, power = [], [], [], 0.0
    for q, phi in parts:
        along = scan.small.along(q, free)
        flat.append(np.ascontiguousarray(phi).reshape(len(phi), -1).view(np.float64))
        taken.append(flat[-1] @ along.rows.T)
        right.append(flat[-1] @ along.target - taken[-1] @ along.onto)
        power = along.power
    ends = np.cumsum([0, *(len(phi) for _, phi in parts)])
    gram = np.zeros((ends[-1], ends[-1]))
    for i, (q, _) in enumerate(parts):
        rows = slice(ends[i], ends[i + 1])
        for j, (other, phi) in enumerate(parts[: i + 1]):
            columns = slice(ends[j], ends[j + 1])
            moved = (
                np.ascontiguousarray(phi * np.sum(q.conj() * other, axis=1)).reshape(len(phi), -1).view(np.float64)
            )
            gram[rows, columns] = flat[i] @ moved.T - taken[i] @ taken[j].T
            gram[columns, rows] = gram[rows, columns].T
    whole = np.diag(gram) + np.concatenate([np.sum(item**2, axis=1) for item in taken])
    return System(gram, np.concatenate(right), power, whole, fixed, positive)


def _by_laws(left: Real, owner: Indices) -> list[tuple[float, tuple[int, int]]]:
    """Least of every block of a table whose rows and columns belong to laws, above the diagonal blocks."""
    starts = np.flatnonzero(np.r_[True, owner[1:] != owner[:-1]])
    least = np.minimum.reduceat(np.minimum.reduceat(left, starts, axis=0), starts, axis=1)
    ends = np.r_[starts[1:], len(owner)]
    found = []
    for a in range(len(starts)):
        for b in range(a + 1, len(starts)):
            if np.isfinite(least[a, b]):
                block = left[starts[a] : ends[a], starts[b] : ends[b]]
                j, k = np.unravel_index(int(np.argmin(block)), block.shape)
                found.append((float(least[a, b]), (int(starts[a] + j), int(starts[b] + k))))
    return found


def _first(item: tuple[float, tuple[int, ...]]) -> float:
    return item[0]
