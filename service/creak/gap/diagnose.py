"""The diagnosis as a whole: `diagnose` and `validate`, the two entries to this package."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from creak.gap import reference
from creak.gap.between import locate
from creak.gap.equivalents import cannot_tell, equivalents
from creak.gap.force import force_curves, missing_force
from creak.gap.hypothesis import Hypothesis, apply
from creak.gap.levels import Division, Level, band_shares, divide, gap_levels, level, node_gaps, noise_bound
from creak.gap.periodic import PeriodicData
from creak.gap.ranking import Ranked, Searched
from creak.gap.records import Cause, Diagnosis, MissingForce, Validation, Verdict
from creak.gap.reference import seen_by, shared_errors, widened
from creak.gap.refine import FINE, Refined, conclude, refine
from creak.gap.regression import Indices
from creak.gap.search import Search
from creak.gap.setting import Setting
from creak.gap.standing import standing, unsettled
from creak.gap.verdict import as_causes, as_corrections, judge, probabilities
from creak.gap.view import check_stable, hold_factor, lines_of
from creak.mechanics.steady import Each
from creak.mechanics.structure import Matrices
from creak.mechanics.system import Model, assemble
from creak.mechanics.vocabulary import VOCABULARY
from creak.records import Rig

Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction done, 0 to 1."""


@dataclass(frozen=True, eq=False)
class _Halves:
    """Experiments that are fitted, those by which the search chooses, and those kept aside for the claim.

    From three realisations on the three are different ones while the search goes on; those by which it chose are
    fitted with the others in the end.
    """

    fitted: Indices
    held: Indices
    realisations: int
    searched: Indices
    chosen_by: Indices


def _halves(data: PeriodicData) -> _Halves:
    """Keep the last fifth of the realisations aside, at least one if there are two."""
    indices = np.unique(data.realisation)
    aside = max(1, round(len(indices) / 5)) if len(indices) > 1 else 0
    held = (
        np.isin(data.realisation, indices[len(indices) - aside :]) if aside else np.zeros(len(data.u), dtype=bool)
    )
    fitted, kept = np.flatnonzero(~held), np.flatnonzero(held)
    apart = data.realisation == indices[-aside - 1] if len(indices) > 2 else held
    return _Halves(fitted, kept, aside, np.flatnonzero(~held & ~apart), np.flatnonzero(apart))


def _silent(what: str, done: float) -> None:
    """Report nothing."""


def diagnose(
    rig: Rig, model: Model, data: PeriodicData, progress: Progress = _silent, each: Each = map
) -> Diagnosis:
    """Find where a recording departs from a model, which effect causes it, and how far it shrinks.

    Parameters
    ----------
    rig : Rig
    model : Model
        One of kind ``frf`` with its response.
    data : PeriodicData
        The recording's complete realisations, see `creak.gap.periodic.gather`.
    progress : callable
    each : callable
        What candidates are tried by, as for `creak.gap.search.Search`.

    Returns
    -------
    Diagnosis

    Raises
    ------
    ConfigurationError
        If the model does not fit the rig or is unstable.
    """
    check_stable(assemble(model, rig))
    rig, data = seen_by(model, rig), widened(rig, model, data)
    halves = _halves(data)
    shown = halves.held if len(halves.held) else halves.fitted
    notes = [*reference.notes(model), *_notes(rig, model, data, halves)]
    setting = Setting(rig, model, data, len(data.variance))
    progress("simulating the model", 0.0)
    every = setting.simulate(Hypothesis(), np.arange(len(data.u)))
    if not every.settled:
        notes.append(
            f"the model's own simulation did not settle in {int((~every.converged).sum())} of {len(data.u)} "
            "experiments, so its gap is that of the last iterate"
        )
    before = level(data, every.y[shown], shown)
    if before.whitened > noise_bound(data, len(shown)) and assemble(model, rig).elements:
        # What the solver leaves open must not count as a gap.
        fine = 2 * setting.samples_a_sample(Hypothesis())
        exact = setting.simulate(Hypothesis(), np.arange(len(data.u)), every.motion, fine, FINE)
        if exact.settled:
            every, before = exact, level(data, exact.y[shown], shown)
    rest = data.Y - lines_of(every.y)
    division = divide(rig, data, rest, lines_of(data.u) * hold_factor(rig)[:, None])
    bands = band_shares(rig, data, division)
    result = Diagnosis(
        Verdict.NO_GAP,
        gap_levels(before, before, gap=False),
        node_gaps(rig, before, before, division),
        (),
        (),
        (),
        (),
        halves.realisations,
        bands,
        (),
        0.0,
        model,
        (),
        tuple(notes),
    )
    if before.whitened <= noise_bound(data, len(shown)):
        progress("done", 1.0)
        return result
    setting = replace(setting, top=_top(rig, data, rest))
    search = Search(setting, halves.searched, halves.chosen_by, progress, each)
    progress("places without a sensor", 0.05)
    hidden = locate(setting, halves.fitted, halves.held, search.floor, search.explains, each)
    if hidden is None:
        searched = search.run()
    else:
        setting = hidden.setting
        notes += hidden.notes()
        places: list[tuple[float, str, tuple[str, ...]]] = [(hidden.rest, "internal", hidden.at)]
        if hidden.refined is not None:
            searched = Searched((Ranked(hidden.refined, 0.0),), True, places, whole=True)
        elif rig.n > 2:  # the place is known, its law is none of the vocabulary
            searched = Searched((), False, places)
        else:
            searched = search.run()
            searched = replace(searched, places=places + searched.places)
    progress("final fit", 0.85)
    concluded = _concluded(result, setting, search, searched, halves, before, division, notes, progress)
    if hidden is None:
        return concluded
    return replace(concluded, where=tuple(hidden.on(force) for force in concluded.where))


def _concluded(
    result: Diagnosis,
    setting: Setting,
    search: Search,
    searched: Searched,
    halves: _Halves,
    before: Level,
    division: Division,
    notes: list[str],
    progress: Progress,
) -> Diagnosis:
    rig, model, data = setting.rig, setting.model, setting.data
    shown = halves.held if len(halves.held) else halves.fitted
    tested = tuple(VOCABULARY)
    after, final = before, None
    if searched.ranked:
        best = searched.ranked[0].refined
        final = best if searched.whole else _final(setting, best, halves, search.each)
        steady = setting.simulate(final.hypothesis, shown)
        if steady.settled:
            after = level(data, steady.y, shown)
        else:
            notes.append("the corrected model's simulation does not settle, so it is not claimed")
            final = None
    gap = gap_levels(before, after, gap=True)
    verdict = judge(gap, final.hypothesis if final else None)
    supposed = final.hypothesis if final and verdict is not Verdict.UNKNOWN else Hypothesis()
    if final is not None and verdict is Verdict.PARTLY_EXPLAINED and not gap.closes:
        stands = standing(search, final)
        if stands.unsettled:
            notes += unsettled(stands.unsettled)
            final, searched = stands.refined, replace(searched, ranked=searched.ranked[:1])
            after = level(data, setting.simulate(final.hypothesis, shown).y, shown)
            gap = gap_levels(before, after, gap=True)
            verdict = judge(gap, final.hypothesis)
    chances, unknown = probabilities(search, searched)
    if verdict is Verdict.UNKNOWN or final is None:
        gap = gap_levels(before, before, gap=True)
        acting = replace(supposed, linear=()) if as_corrections(supposed) else supposed
        where = missing_force(setting, acting, searched.places, halves.fitted)
        return replace(
            result,
            verdict=Verdict.UNKNOWN,
            gap=replace(gap, closed=0.0),
            where=where,
            curves=force_curves(setting, Hypothesis(), where, halves.fitted),
            unknown_probability=1.0,
            tested=tested,
            not_claimed=tuple(notes),
        )
    named = as_causes(setting, final, searched, chances, halves.fitted, shown, gap)
    shared = shared_errors(model, data, len(halves.fitted))
    corrected = apply(model, final.hypothesis)
    where, seen, shown_there = _where(setting, final.hypothesis, supposed, searched, halves)
    where = _in_order(where, named.causes)
    progress("done", 1.0)
    return replace(
        result,
        verdict=verdict,
        gap=gap,
        nodes=node_gaps(rig, before, after, division),
        where=where,
        causes=tuple(_wider(cause, shared) for cause in named.causes),
        alternatives=tuple(
            _wider(cause, shared) for cause in equivalents(rig, corrected, named.causes, named.alternatives)
        ),
        linear_corrections=tuple(
            replace(item, standard_error=shared * item.standard_error) for item in named.corrections
        ),
        curves=force_curves(seen, shown_there, where, halves.fitted),
        unknown_probability=unknown,
        corrected=corrected,
        tested=tested,
        not_claimed=(*notes, *cannot_tell(rig, named.causes)),
    )


def _wider(cause: Cause, factor: float) -> Cause:
    return replace(cause, standard_errors={key: factor * error for key, error in cause.standard_errors.items()})


def _in_order(where: Sequence[MissingForce], causes: Sequence[Cause]) -> tuple[MissingForce, ...]:
    """Places in falling share; of an actuator and its node, which share one pattern, that of the earlier cause."""
    rank = {cause.at: i for i, cause in reversed(list(enumerate(causes)))}
    return tuple(sorted(where, key=lambda force: (-round(force.share, 6), rank.get(force.at, len(rank)))))


def _where(
    setting: Setting, hypothesis: Hypothesis, supposed: Hypothesis, searched: Searched, halves: _Halves
) -> tuple[tuple[MissingForce, ...], Setting, Hypothesis]:
    """Places of the effects, and of those that were supposed and are not claimed.

    Linear corrections beside them are in the model that they are seen through.
    """
    if supposed.effects and as_corrections(supposed):
        corrected = apply(setting.model, Hypothesis(linear=supposed.linear))
        setting = replace(setting, model=corrected)
        hypothesis, supposed = replace(hypothesis, linear=()), replace(supposed, linear=())
    return missing_force(setting, supposed, searched.places, halves.fitted), setting, hypothesis


def _final(setting: Setting, refined: Refined, halves: _Halves, each: Each) -> Refined:
    """Fit to the end, to all experiments that may be fitted."""
    whole = as_corrections(refined.hypothesis)
    final = conclude(setting, refined.hypothesis, halves.fitted, halves.held[:6], whole=whole, each=each)
    return final if final.settled else refined


def _top(rig: Rig, data: PeriodicData, rest: np.ndarray) -> int:
    """Lines, from DC on, that hold a gap above noise, in blocks; at least the excited ones and a fifth more."""
    block = 16
    lines = rest.shape[1]
    white = np.mean(np.abs(rest) ** 2 / data.variance, axis=(0, 2))
    blocks = white[: lines // block * block].reshape(-1, block).mean(axis=1)
    floor = data.degrees / (data.degrees - 1)
    count = block * rest.shape[0] * rest.shape[2]
    above = np.flatnonzero(blocks > floor * (1 + 6 / np.sqrt(count) + 3 / np.sqrt(data.degrees * block)))
    least = min(int(1.2 * rig.lines[-1]) + 2, lines)
    return int(min(max((above[-1] + 1) * block if len(above) else 0, least), lines))


def _notes(rig: Rig, model: Model, data: PeriodicData, halves: _Halves) -> list[str]:
    notes = []
    if not halves.realisations:
        notes.append(
            "the recording has one realisation, so nothing could be kept aside: the gaps are those of the data "
            "that were fitted, and that the correction holds for other excitations is not claimed"
        )
    elif len(np.unique(data.realisation)) == 2:
        notes.append(
            "the recording has two realisations, so the one kept aside also chose among hypotheses, and the gap "
            "after correction may look a little smaller than it is"
        )
    if rig.n == 1:
        notes.append("one node is measured, so ground, actuator and sensor are told apart by their laws alone")
    if data.periods == 1:
        notes.append(
            "there is one period an experiment, so noise is what the lines hold that are not excited: even "
            "distortion counts as noise"
        )
    if data.degrees <= 3:
        notes.append("the noise is known from very few periods")
    if rig.n == 1:
        notes.append("effects at points without a sensor were not tested, since one sensor cannot place them")
    elif isinstance(model, Matrices):
        notes.append("effects at degrees of freedom that the model does not name were not tested")
    return notes


def validate(rig: Rig, model: Model, diagnosis: Diagnosis, other: PeriodicData) -> Validation:
    """See whether a corrected model holds in another recording, at best at another amplitude.

    An effect of the right kind keeps its parameters there; one that stands in for another was right at one
    amplitude only, and needs other numbers at the second or does not fit at all.

    Parameters
    ----------
    rig : Rig
    model : Model
        As it was diagnosed.
    diagnosis : Diagnosis
    other : PeriodicData

    Returns
    -------
    Validation
    """
    rig, other = seen_by(model, rig), widened(rig, model, other)
    every = np.arange(len(other.u))
    old = Setting(rig, model, other, len(other.variance)).simulate(Hypothesis(), every)
    setting = Setting(rig, diagnosis.corrected, other, len(other.variance))
    new = setting.simulate(Hypothesis(), every)
    before, after = level(other, old.y, every), level(other, new.y, every)
    gap = gap_levels(before, after, gap=True)
    rest = other.Y - lines_of(old.y)
    division = divide(rig, other, rest, lines_of(other.u) * hold_factor(rig)[:, None])
    nodes = node_gaps(rig, before, after, division)
    named = (
        ", ".join(f"{cause.effect} at {'-'.join(cause.at)}" for cause in diagnosis.causes)
        or "the linear corrections"
    )
    if diagnosis.verdict in (Verdict.NO_GAP, Verdict.UNKNOWN):
        holds = after.whitened <= noise_bound(other, len(every))
        state = "agrees with the other recording too" if holds else "leaves a gap in the other recording"
        return Validation(holds, gap, nodes, {}, f"Nothing was put into the model; it {state}.")
    if not new.settled:
        return Validation(False, gap, nodes, {}, "The corrected model does not settle at the other inputs.")
    holds = gap.closes
    if holds:
        return Validation(True, gap, nodes, {}, f"The model with {named} holds in the other recording.")
    refitted = _refitted(setting, diagnosis, other)
    moved = "; fitted anew it has other parameters there" if refitted else ""
    return Validation(
        False,
        gap,
        nodes,
        refitted,
        f"{named} stands in for another effect: it does not hold in the other recording{moved}.",
    )


def _refitted(setting: Setting, diagnosis: Diagnosis, other: PeriodicData) -> dict[str, float]:
    """Parameters of the causes fitted to another recording; empty where that does not settle."""
    model = diagnosis.corrected
    wanted = [(cause.effect, cause.at) for cause in diagnosis.causes]
    chosen = [i for i, effect in enumerate(model.effects) if (effect.effect, effect.at) in wanted]
    hypothesis = Hypothesis(tuple(model.effects[i] for i in chosen), (), tuple(chosen))
    few = np.arange(len(other.u))[:6]
    refined = refine(replace(setting, top=_top(setting.rig, other, other.Y)), hypothesis, few, few[:0], 3)
    if not refined.settled:
        return {}
    return {
        f"{effect}: {name}": value
        for effect in refined.hypothesis.effects
        for name, value in effect.parameters().items()
    }
