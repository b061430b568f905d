"""How answers compare with truths: rates, errors, and the confusion of effects, as tables."""

import math
from collections import Counter
from statistics import median

CLEAR_DB = 6.0
"""Least gap above noise for place and verdict to count."""

NAMED_DB = 15.0
"""Least gap above noise for the effect's name to count."""

MOST_ALTERNATIVES = 3

GOALS = {
    "place right": 0.98,
    "effect right, or among the alternatives": 0.97,
    "outside effects unknown or partly explained": 0.95,
    "no gap called so": 0.98,
}


def same_place(at, truth):
    """Whether a place is that of the truth; a resonator's may name the ground beside its node."""
    if len(truth["at"]) == 1 and truth["effect"] == "resonator":
        return set(at) - {"ground"} == set(truth["at"])
    return set(at) == set(truth["at"])


def clearness(truth):
    """Gap above noise that the effect itself makes, dB.

    Where the model's linear part is off as well, the gap that the effect adds to the true linear structure
    counts: otherwise an invisible effect would be asked for because masses are wrong.
    """
    return truth["effect_to_noise_db"] if truth["linear_error"] else truth["gap_to_noise_db"]


def judge(trial):
    """What one trial adds to the tables.

    Returns
    -------
    dict
        Of True, False or a number for what counts in this case; what does not is left out.
    """
    truth, answer = trial["truth"], trial["answer"]
    verdict = answer["verdict"] if answer else "failed"
    if truth["kind"] == "none":
        return {"no gap": verdict == "no_gap"}
    marks = {}
    if clearness(truth) < CLEAR_DB:
        return marks
    where = answer["where"] if answer else []
    marks["place"] = bool(where) and same_place(where[0]["at"], truth)
    if truth["kind"] == "outside":
        marks["outside"] = verdict in ("unknown", "partly_explained")
        return marks
    closed = answer["gap"]["closed"] if answer else None
    marks["closed"] = 0.0 if closed is None else closed
    if clearness(truth) < NAMED_DB:
        return marks
    causes = answer["causes"] if answer else []
    found = next((cause for cause in causes if _is(cause, truth)), None)
    others = answer["alternatives"][:MOST_ALTERNATIVES] if answer else []
    marks["named"] = found is not None
    marks["effect"] = found is not None or any(_is(other, truth) for other in others)
    if found is not None:
        marks["extra causes"] = len(causes) - 1
        for name, value in truth["parameters"].items():
            marks[f"error of {name}"] = abs(found["parameters"][name] / value - 1)
            error = found["standard_errors"].get(name)
            if error:
                marks[f"deviate of {name}"] = (found["parameters"][name] - value) / error
    return marks


def _is(cause, truth):
    return cause["effect"] == truth["effect"] and same_place(cause["at"], truth)


def answered(trial):
    """First cause named, or the verdict without one, for the confusion matrix."""
    answer = trial["answer"]
    if answer is None:
        return "(failed)"
    return answer["causes"][0]["effect"] if answer["causes"] else f"({answer['verdict']})"


def summary(trials):
    """Rates and medians of many trials.

    Parameters
    ----------
    trials : list of dict
        As `trial.run` returns them.

    Returns
    -------
    dict
        JSON: for every rate right, of, rate; medians; the confusion as rows of counts.
    """
    marks = [judge(trial) for trial in trials]

    def rate(key):
        values = [mark[key] for mark in marks if key in mark]
        right = sum(values)
        return {"right": right, "of": len(values), "rate": right / len(values) if values else None}

    def middle(values):
        values = list(values)
        return median(values) if values else None

    errors = [v for mark in marks for key, v in mark.items() if key.startswith("error of")]
    deviates = [v for mark in marks for key, v in mark.items() if key.startswith("deviate of")]
    confusion = {}
    for trial, mark in zip(trials, marks, strict=True):
        if "no gap" in mark or "effect" in mark or "outside" in mark:
            row = confusion.setdefault(trial["truth"]["effect"] or "(no gap)", Counter())
            row[answered(trial)] += 1
    return {
        "cases": len(trials),
        "failed": sum(trial["answer"] is None for trial in trials),
        "rates": {
            "place right": rate("place"),
            "effect right, or among the alternatives": rate("effect"),
            "effect right, as first named": rate("named"),
            "outside effects unknown or partly explained": rate("outside"),
            "no gap called so": rate("no gap"),
        },
        "parameter_error_median": middle(errors),
        "parameters": len(errors),
        "within_1_96_standard_errors": sum(abs(v) < 1.96 for v in deviates) / len(deviates) if deviates else None,
        "closed_median": middle(mark["closed"] for mark in marks if "closed" in mark),
        "with_extra_causes": sum(mark.get("extra causes", 0) > 0 for mark in marks),
        "seconds_median": middle(trial["cpu_seconds"] for trial in trials),
        "seconds_most": max((trial["cpu_seconds"] for trial in trials), default=math.nan),
        "confusion": {name: dict(row) for name, row in sorted(confusion.items())},
    }


def tables(result):
    """The summary as Markdown."""
    rows = ["| | right | of | rate | goal |", "|---|---|---|---|---|"]
    for name, value in result["rates"].items():
        share = "–" if value["rate"] is None else f"{100 * value['rate']:.1f} %"
        goal = f"≥ {100 * GOALS[name]:.0f} %" if name in GOALS else ""
        rows.append(f"| {name} | {value['right']} | {value['of']} | {share} | {goal} |")

    def shown(value, form):
        return "–" if value is None else form.format(value)

    rows += [
        "",
        f"{result['cases']} cases, {result['failed']} without an answer. Parameters: median error "
        f"{shown(result['parameter_error_median'], '{:.2%}')} of {result['parameters']} (goal 1 %), "
        f"{shown(result['within_1_96_standard_errors'], '{:.1%}')} within 1.96 of their standard errors. "
        f"Closed, median: {shown(result['closed_median'], '{:.3%}')} (goal 99.9 %). "
        f"With causes that are none: {result['with_extra_causes']}. "
        f"Processor seconds a diagnosis: median {shown(result['seconds_median'], '{:.1f}')}, "
        f"most {result['seconds_most']:.1f}.",
        "",
    ]
    answers = sorted({name for row in result["confusion"].values() for name in row})
    rows.append("| truth \\ first answer | " + " | ".join(answers) + " |")
    rows.append("|---" * (len(answers) + 1) + "|")
    for truth, row in result["confusion"].items():
        rows.append(f"| {truth} | " + " | ".join(str(row.get(name, "")) for name in answers) + " |")
    return "\n".join(rows)
