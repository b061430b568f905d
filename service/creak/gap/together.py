"""Several effects at places of their own: each one's law is sought while the forces at the other places are free.

With more nodes than places the forces need no law to be known: what they leave tells the places, and with them
the motion of every node as it was before its sensor. So a law is tried alone, whatever acts elsewhere, and a
sensor that has spoilt the motion of its node does not mislead the laws that act there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Final

import numpy as np

from creak.gap.chains import chained
from creak.gap.combinations import Combinations
from creak.gap.scan import Found, Place, Scan, Trial
from creak.gap.view import View, samples_of
from creak.mechanics.steady import Each
from creak.records import Complex, Real

NOISE: Final = 1.15  # what free forces at the right places leave at most, relative to noise
_SETS = 40  # sets of places that leave as little: closed triangles alone make sixteen of three
_WIDENED = 20  # pairs of places to which a third is added
_ALIKE = 1e-3  # part of a pattern beyond those of other places, below which it is theirs
_CLEAR = 4.0  # power over noise beyond which a line of a force moves the nodes
_FAILED = 5.0  # what a law leaves that has not explained its place,
_HOPELESS = 5e-3  # and of what was there
_LAWS = 3  # of a place that go on
_JOINT = 6  # combinations of them that are fitted, of a set

Spot = tuple[Place, ...]
"""Places of one pattern: an element between a node and the ground, and most actuators at it."""

Laws = tuple[Trial, ...]


class Together:
    """Search for laws at two or three places, fewer than there are nodes.

    Parameters
    ----------
    scan : Scan
    each : callable
        What places and sets are tried by, as for `creak.gap.search.Search`.
    """

    def __init__(self, scan: Scan, each: Each = map) -> None:
        self.scan, self.each = scan, each

    def run(self) -> list[Found]:
        """Hypotheses of a law at every place of a set, or two at one of two places; the best first."""
        sets = spot_sets(self.scan)
        found = self._found([_Sought(spots, None) for spots in sets])
        if not found and sets and len(sets[0]) == 2:
            found = self._found([_Sought(spots, double) for spots in sets for double in spots])
        return sorted(found, key=lambda item: item.rest)

    def _found(self, sought: Sequence["_Sought"]) -> list[Found]:
        """Hypotheses for sets of places; a set is given up at the first place that no law explains."""
        known: dict[_Key, list[Laws]] = {}
        left = list(sought)
        for k in range(max((len(one.keys) for one in left), default=0)):
            new = list(dict.fromkeys(one.keys[k] for one in left if one.keys[k] not in known))
            known.update(zip(new, self.each(partial(_laws, self.scan), new), strict=True))
            left = [one for one in left if known[one.keys[k]]]
        options = [(one.spots, [known[key] for key in one.keys]) for one in left]
        return [item for some in self.each(partial(_joint, self.scan), options) for item in some]


@dataclass(frozen=True)
class _Key:
    """Laws of one place, those of the others free; two at a time if it is `double`."""

    spot: Spot
    others: tuple[Spot, ...]
    double: bool


class _Sought:
    """One set of places; two laws at `double`, which comes last."""

    def __init__(self, spots: tuple[Spot, ...], double: Spot | None) -> None:
        self.spots = spots
        self.keys = [
            _Key(spot, tuple(sorted(other for other in spots if other != spot)), spot == double)
            for spot in sorted(spots, key=lambda item: item == double)
        ]


def _joint(scan: Scan, options: tuple[Sequence[Spot], Sequence[Sequence[Laws]]]) -> list[Found]:
    """Hypotheses of the best combinations of laws, a choice for every place of a set."""
    spots, laws = options
    view = _seen(scan, spots)
    whole = Scan(view, *scan.sets, scan.floor)
    joint = sorted(product(*laws), key=lambda some: sum(_rest(item) for item in some))[:_JOINT]
    return [
        whole.hypothesis([_whole(view, trial) for item in some for trial in item], whole.none) for some in joint
    ]


def _laws(scan: Scan, key: _Key) -> list[Laws]:
    """Best laws at one place, or pairs of them, the forces at the others left free; none if all fail."""
    view = opened(_seen(scan, [key.spot, *key.others]), [other[0] for other in key.others])
    alone = Scan(view, *scan.sets, scan.floor * _left(view))
    single = [trial for group, at in key.spot for trial in alone.trials(group, at, alone.none)]
    single = sorted((trial for trial in single if np.isfinite(trial.rest)), key=lambda trial: trial.rest)
    laws: list[Laws] = [(trial,) for trial in single[:_LAWS]]
    if key.double:
        laws = list(Combinations(alone, key.spot, alone.none, single).best(2, _LAWS))
        laws += [pair for place in key.spot for pair in chained(alone, place)]
    bound = max(_FAILED, _HOPELESS * alone.rest())
    return sorted((item for item in laws if _rest(item) < bound), key=_rest)


def _seen(scan: Scan, spots: Sequence[Spot]) -> View:
    """View whose motion no sensor has spoilt."""
    places = [spot[0] for spot in spots]
    return moved(scan.view, places) if any(group == "sensor" for group, _ in places) else scan.view


def spot_sets(scan: Scan) -> list[tuple[Spot, ...]]:
    """Fewest places, two or three, whose free forces leave noise: all sets that do so as well as the best."""
    n = scan.view.rig.n
    if n < 3:
        return []
    spots = _spots(scan)
    by_first = {spot[0]: spot for spot in spots}
    pairs = [(rest, one, other) for rest, one, other in scan.place_pairs() if {one, other} <= set(by_first)]
    found: list[tuple[float, tuple[Spot, ...]]]
    found = [(rest, (by_first[one], by_first[other])) for rest, one, other in pairs]
    if found[0][0] > NOISE:
        if n == 3:
            return []
        thirds = [
            (rest, (by_first[one], by_first[other], by_first[group, at]))
            for _, one, other in pairs[:_WIDENED]
            for rest, group, at in scan.places(scan.none, (one, other))
            if (group, at) in by_first and (group, at) not in (one, other)
        ]
        least = min(rest for rest, _ in thirds)
        if least > NOISE:
            return []
        best = min(thirds, key=lambda item: item[0])[1]
        found = _alike(scan, spots, best, least)
    least = min(rest for rest, _ in found)
    kept: dict[frozenset[Spot], tuple[Spot, ...]] = {}
    for rest, some in sorted(found, key=lambda item: item[0]):
        if rest <= 1.02 * least + 0.02:
            kept.setdefault(frozenset(some), some)
    return list(kept.values())[:_SETS]


def _alike(
    scan: Scan, spots: Sequence[Spot], best: tuple[Spot, ...], least: float
) -> list[tuple[float, tuple[Spot, ...]]]:
    """Sets of three places that make the same forces as the best one, itself among them."""
    view = scan.view
    basis = _unit(_patterns(view, [spot[0] for spot in best]))[0]
    basis = np.linalg.svd(basis, full_matrices=False)[0]
    inside = []
    for spot in spots:
        q = _unit(_patterns(view, spot[:1]))[0][..., 0]
        out = q - np.einsum("lnk,lk->ln", basis, np.einsum("lnk,ln->lk", basis.conj(), q))
        if np.median(np.linalg.norm(out, axis=1)) < _ALIKE:
            inside.append(spot)
    found: list[tuple[float, tuple[Spot, ...]]] = []
    for i, one in enumerate(inside):
        for j, other in enumerate(inside[:i]):
            for third in inside[:j]:
                some = one, other, third
                sizes = np.linalg.svd(_unit(_patterns(view, [s[0] for s in some]))[0], compute_uv=False)
                if np.median(sizes[:, -1]) > _ALIKE:
                    found.append((least, some))
    return found


def _spots(scan: Scan) -> list[Spot]:
    """Every place, those of one pattern together."""
    view = scan.view
    spots: list[list[Place]] = []
    patterns: list[Complex] = []
    for _, group, at in sorted(scan.places(scan.none), key=lambda item: item[1:]):
        q = _unit(_patterns(view, [(group, at)]))[0][..., 0]
        # A force at the end of a structure may move its node alone; a sensor spoils the motion, a force does not.
        alike = [
            (spot[0][0] == "sensor") == (group == "sensor")
            and np.median(np.abs(np.sum(q.conj() * other, axis=1))) > 1 - _ALIKE**2
            for spot, other in zip(spots, patterns, strict=True)
        ]
        if any(alike):
            spots[alike.index(True)].append((group, at))
        else:
            spots.append([(group, at)])
            patterns.append(q)
    return [tuple(sorted(spot, key=lambda place: place[0] != "internal")) for spot in spots]


def opened(view: View, places: Sequence[Place]) -> View:
    """Leave forces at places free: what they can make is taken out of the motion and of every pattern."""
    basis, sizes, _ = np.linalg.svd(_unit(_patterns(view, places))[0], full_matrices=False)
    basis = np.where(sizes[:, None] > _ALIKE * sizes[:, :1, None], basis, 0.0)
    r = view.r - np.einsum("lnk,elk->eln", basis, np.einsum("lnk,eln->elk", basis.conj(), view.r))
    return replace(view, r=r, opened=basis)


def moved(view: View, places: Sequence[Place]) -> View:
    """Motion of the nodes as the model has it under the forces at places, in the stead of what was measured."""
    patterns = _patterns(view, places)
    unit, length = _unit(patterns)
    inverse = np.linalg.pinv(unit, rcond=_ALIKE) / length[..., None]
    forces = np.einsum("lkn,eln->elk", inverse, view.r)
    noise = np.sum(np.abs(inverse) ** 2, axis=2)
    forces *= np.mean(np.abs(forces) ** 2, axis=0) > _CLEAR * noise
    acts = np.array([group != "sensor" for group, _ in places])
    size, kept = view.u.shape[-1], len(view.s)
    lines: Complex = np.zeros((len(view.r), size // 2 + 1, view.rig.n), dtype=np.complex128)
    lines[:, :kept] = np.einsum("lnk,elk->eln", patterns[..., acts], forces[..., acts]) * view.sigma
    motion = view.motion - samples_of(lines, size)
    lines[:, :kept] = np.fft.rfft(motion, axis=-1).transpose(0, 2, 1)[:, :kept] / size
    s = 2j * np.pi * np.arange(size // 2 + 1) * view.rig.sample_rate / size
    order = np.array(view.system.derivatives)
    divisor = np.where((s[:, None] == 0) & (order > 0), np.inf, s[:, None] ** order)
    D = np.asarray(lines / divisor, dtype=np.complex128)
    return replace(view, d=samples_of(D, size), v=samples_of(s[:, None] * D, size), D=D[:, :kept], motion=motion)


def _patterns(view: View, places: Sequence[Place]) -> Complex:
    """Patterns of places, ``(L, n, k)``."""
    return np.stack([view.pattern(at, group) for group, at in places], axis=-1)


def _unit(patterns: Complex) -> tuple[Complex, Real]:
    """Patterns of length 1, and their lengths ``(L, k)``: a sensor's and a force's are of unlike size."""
    size = np.maximum(np.linalg.norm(patterns, axis=1), 1e-300)
    return patterns / size[:, None], size


def _whole(view: View, trial: Trial) -> Trial:
    """The same law with the pattern that it has where nothing is left free."""
    return replace(trial, column=replace(trial.column, q=trial.candidate.pattern(view)))


def _left(view: View) -> float:
    """Share of the noise that free forces leave."""
    assert view.opened is not None
    return float(1 - np.sum(np.abs(view.opened) ** 2) / len(view.s) / view.rig.n)


def _rest(laws: Laws) -> float:
    return min(trial.rest for trial in laws)
