"""Blind trials: the generator's equations are right, the truth stays sealed, the score counts, a few run."""

import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from blind import chosen, score, several, trial
from blind.cases import draw, multisines
from blind.effects import responses
from blind.motion import LAWS, Structure, element_force, steady
from creak.config.model import parse_model
from creak.config.rig import parse_rig
from creak.mechanics.steady import simulate_steady
from creak.mechanics.system import assemble

FS, SIZE = 500.0, 512
PAIR = Structure(
    np.diag([1.0, 0.8]),
    np.array([[30.0, -12.0], [-12.0, 25.0]]),
    np.array([[3e4, -1e4], [-1e4, 2.5e4]]),
    {"1": np.array([1.0, 0.0]), "2": np.array([0.0, 1.0])},
    ["1", "2"],
)
CONSTANTS = {
    "cubic_stiffness": (1e9, 0.0),
    "quadratic_stiffness": (1e6, 0.0),
    "clearance": (2e4, 5e-4),
    "one_sided_stop": (2e4, 4e-4),
    "coulomb_friction": (6.0, 0.02),
    "quadratic_damping": (100.0, 0.0),
    "hysteresis": (1e4, 6e-4),
    "tanh_spring": (1e4, 5e-4),
    "magnetic_detent": (4.0, 3e-3),
    "nonlinear_inertia": (2e5, 0.0),
    "velocity_stiffness": (1e4, 0.1),
}


@pytest.mark.parametrize("law", LAWS)
def test_integrator_agrees_with_solve_ivp_between_events(law):
    """The compiled integrator that makes the cases, against scipy's with the laws' kinks located as events."""
    at, (p, q) = ("2", "ground"), CONSTANTS[law]
    u = multisines(np.random.default_rng(1), 2, 1, FS, SIZE, (5.0, 40.0), 20.0)[:1]
    y, v = (steady(PAIR, [(law, at, (p, q))], u, FS, order, tolerance=1e-8)[0] for order in (0, 1))
    lines = np.flatnonzero(np.abs(np.fft.rfft(u[0, 0])) > 1e-6)
    amplitude = 2 / SIZE * np.fft.rfft(u[0])[:, lines]

    def rate(t, state):
        x, s, z = state[:2], state[2:4], state[4]
        drive = np.real(amplitude @ np.exp(2j * np.pi * lines * FS / SIZE * t))
        plain = np.linalg.solve(PAIR.mass, drive - PAIR.damping @ s - PAIR.stiffness @ x)
        slope = 0.0
        if law == "nonlinear_inertia":
            whole = PAIR.mass + np.diag([0.0, p * x[1] ** 2])
            right = PAIR.mass @ plain - np.array([0.0, p * x[1] * s[1] ** 2])
            return [*s, *np.linalg.solve(whole, right), 0.0]
        if law == "hysteresis":
            slope = s[1] * (1 - 0.5 * (1 + np.sign(s[1] * z)) * (z / q) ** 2)
        force = element_force(LAWS.index(law), p, q, x[1], s[1], z)
        return [*s, *(plain - np.array([0.0, force / 0.8])), slope]

    # The memory of the hysteresis from the force balance, which the accelerations give.
    a = steady(PAIR, [(law, at, (p, q))], u, FS, 2, tolerance=1e-8)[0]
    taken = u[0, :, 0] - PAIR.mass @ a[:, 0] - PAIR.damping @ v[:, 0] - PAIR.stiffness @ y[:, 0]
    begin = [*y[:, 0], *v[:, 0], taken[1] / p if law == "hysteresis" else 0.0]
    state, t, out = np.array(begin), 0.0, [y[:, 0]]
    times = np.arange(1, SIZE // 2) / FS
    kinks = {"clearance": (q, -q), "one_sided_stop": (q,), "quadratic_damping": (), "hysteresis": ()}.get(law, ())
    events = [lambda t, s, k=k: s[1] - k for k in kinks]
    events += [lambda t, s: s[3]] if law in ("quadratic_damping", "hysteresis") else []
    for event in events:
        event.terminal = True
    while len(out) <= len(times):
        wanted = times[len(out) - 1 :]
        part = solve_ivp(
            rate, (t, times[-1]), state, "DOP853", t_eval=wanted, events=events or None, rtol=1e-8, atol=1e-10
        )
        out += list(part.y[:2].T) if len(part.t) else []
        if part.status == 0:
            break
        last = np.concatenate([[e[-1]] for e in part.t_events if len(e)]).max()
        state = next(s[-1] for e, s in zip(part.t_events, part.y_events, strict=True) if len(e) and e[-1] == last)
        state = state + 1e-9 * np.array(rate(last, state))  # past the kink, or it would be found again
        t = last + 1e-9
    out = np.array(out).T
    reference = y[:, : out.shape[1]]
    assert out.shape[1] > SIZE // 2 - 3
    assert np.sum((out - reference) ** 2) < 1e-8 * np.sum(reference**2)  # -80 dB
    linear = responses(PAIR, None, (), {}, u, FS, 0, held=False)[0]
    assert np.sum((linear[:, : out.shape[1]] - reference) ** 2) > 1e-3 * np.sum(reference**2)


@pytest.mark.parametrize("index", [3, 8, 16, 27, 37, 39, 43])
def test_simulator_and_generator_agree_to_the_noise(index):
    """With the true model nothing but noise is left: two sets of equations, one contract (signs, units, holds)."""
    case = draw(1, index)
    rig = parse_rig(case.rig, "rig.toml")
    size = rig.period_samples
    system = assemble(parse_model(case.truth["model"], "model.toml"), rig)
    solved = simulate_steady(system, case.u[..., :size], rig.sample_rate, rig.hold)
    periods = case.y[..., size:].reshape(*case.y.shape[:2], -1, size)
    noise = periods.var(axis=2, ddof=1).mean(axis=(0, 2)) / periods.shape[2]
    rest = np.mean((periods.mean(axis=2) - solved.y) ** 2, axis=(0, 2))
    np.testing.assert_allclose(rest / noise, 1.0, atol=0.06)


def test_set_holds_what_it_promises():
    """15 % without gap, 15 % outside, at any length of the set; and the same case from the same seed."""
    kinds = [draw(5, index).truth["kind"] for index in (0, 4)]
    assert kinds == [draw(5, index).truth["kind"] for index in (0, 4)]
    turns = [np.random.default_rng(5).permutation(20)[index % 20] for index in range(200)]
    assert sum(turn < 3 for turn in turns) == 30
    assert sum(3 <= turn < 6 for turn in turns) == 30


def test_sealed_truth_tells_nothing_without_its_key(tmp_path):
    """Neither words nor their length of repetition may show through; the key brings all back."""
    truth = {"effect": "cubic_stiffness", "at": ["3", "ground"], "parameters": {"coefficient": 1e8}}
    keys = [trial.seal(truth, tmp_path / str(i)) for i in range(2)]
    sealed = [(tmp_path / str(i)).read_bytes() for i in range(2)]
    assert sealed[0] != sealed[1]
    assert b"cubic" not in sealed[0]
    assert trial.unseal(tmp_path / "0", keys[0]) == truth
    with pytest.raises(ValueError):
        json.loads(bytes(a ^ b for a, b in zip(sealed[0], keys[1], strict=True)).decode("latin-1"))


def test_diagnosis_cannot_import_the_generator():
    """The tests' folder on its path would let it draw the case again."""
    paths = trial.environment()["PYTHONPATH"].split(":")
    assert [path.rsplit("/", 1)[-1] for path in paths] == ["service"]


def made(kind="vocabulary", effect="cubic_stiffness", gap=30.0, verdict="explained", causes=(), others=()):
    """A trial with a made-up truth and answer; causes as (effect, place, coefficient)."""

    def entries(found):
        return [
            {"effect": e, "at": list(a), "parameters": {"coefficient": c}, "standard_errors": {"coefficient": 1e6}}
            for e, a, c in found
        ]

    at = ("3", "ground")
    truth = {"kind": kind, "effect": effect, "at": list(at), "parameters": {"coefficient": 1e8}}
    truth |= {"linear_error": False, "gap_to_noise_db": gap, "effect_to_noise_db": gap}
    answer = {
        "verdict": verdict,
        "gap": {"closed": 0.9999},
        "where": [{"at": list(at)}],
        "causes": entries(causes),
        "alternatives": entries(others),
    }
    return {"truth": truth, "answer": answer, "error": None, "seconds": 1.0, "cpu_seconds": 1.0}


RIGHT = ("cubic_stiffness", ("ground", "3"), 1.01e8)
ELSEWHERE = ("cubic_stiffness", ("2", "ground"), 1e8)
OTHER = ("clearance", ("3", "ground"), 1e8)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (made(causes=[RIGHT]), {"place": True, "effect": True, "named": True, "extra causes": 0}),
        (made(causes=[OTHER, RIGHT]), {"effect": True, "named": True, "extra causes": 1}),
        (made(causes=[OTHER], others=[RIGHT]), {"effect": True, "named": False}),
        (made(causes=[OTHER], others=[OTHER] * 3 + [RIGHT]), {"effect": False}),
        (made(causes=[ELSEWHERE]), {"effect": False, "named": False}),
        (made(gap=10.0, causes=[OTHER]), {"place": True, "closed": 0.9999}),
        (made(gap=5.0, causes=[OTHER]), {}),
        (made("outside", "tanh_spring", causes=[OTHER]), {"outside": False, "place": True}),
        (made("outside", "tanh_spring", verdict="partly_explained"), {"outside": True}),
        (made("none", None, verdict="no_gap"), {"no gap": True}),
        (made("none", None, verdict="explained", causes=[RIGHT]), {"no gap": False}),
    ],
)
def test_judgement(given, expected):
    """What is scored from which gap on, and what counts as right."""
    marks = score.judge(given)
    assert {key: marks[key] for key in expected} == expected
    if not expected:
        assert marks == {}


def test_missing_answer_counts_as_wrong():
    """A diagnosis that crashes on hard cases would otherwise look better than one that answers."""
    trials = [made(causes=[RIGHT]), {**made(), "answer": None, "error": "no answer"}]
    result = score.summary(trials)
    assert result["rates"]["place right"] == {"right": 1, "of": 2, "rate": 0.5}
    assert result["rates"]["effect right, or among the alternatives"]["right"] == 1
    assert result["parameter_error_median"] == pytest.approx(0.01)
    assert "| cubic_stiffness | 1 | 1 |" in score.tables(result)


@pytest.mark.parametrize("index", [0, 7, 12, 36])
def test_blind_case(index, tmp_path):
    """From measurement to verdict through the commands, the truth unknown to them."""
    result = trial.run(draw(1, index), tmp_path)
    marks = score.judge(result)
    assert result["error"] is None
    assert marks
    assert all(value is not False for value in marks.values()), (result["truth"], result["answer"])
    assert not list(tmp_path.iterdir())


def test_a_healthy_recording_takes_the_place_of_the_model():
    """The sealed trial of a measured model: two processes that import, one that diagnoses, no equations given."""
    result = chosen.one(6, ("mass", "damping", "mass"), 300.0, True, 2)
    row = chosen.summary([result])
    assert (row["clear"], row["place"], row["named first"], row["with causes that are none"]) == (1, 1, 1, 0)
    assert row["error_largest"] < 1e-3  # 40 dB above noise


THREE = {
    "effects": [
        {"effect": "cubic_stiffness", "at": ["1", "ground"]},
        {"effect": "hysteresis", "at": ["1", "2"]},
        {"effect": "sensor_delay", "at": ["2"]},
    ],
    "left_db": {"0": -12.0, "1": -11.8, "2": -5.0, "0-1": -14.0, "0-2": -20.0, "1-2": -20.3},
}


@pytest.mark.parametrize(
    ("order", "ordered"),
    [
        ([0, 2, 1], True),
        ([1, 2, 0], True),  # nearly as much as with the first
        ([0, 1, 2], False),  # with the third in second place less would be left
        ([2, 0, 1], False),
        ([0, 2], False),
        ([], False),
    ],
)
def test_waterfall_is_held_against_what_the_true_effects_leave(order, ordered):
    """Kills a score that takes any falling waterfall for one in the order of importance."""
    causes = [
        {"effect": item["effect"], "at": item["at"][::-1], "gap_after_db": -10.0 * k}
        for k, item in enumerate(THREE["effects"][i] for i in order)
    ]
    mark = several.score(THREE, {"causes": causes})
    assert mark["ordered"] is ordered
    assert mark["found"] == len(order)
    assert mark["all"] is (len(order) == 3)
    assert not mark["invented"]
    assert mark["falling"]


def test_effects_drawn_together_stand_clear_of_noise():
    """Kills a drawing in which one of two effects could not be found by anybody."""
    case = several.draw(1, 2, 2)
    floor = -case.truth["snr_db"] - 10 * np.log10(2)
    assert len(case.truth["effects"]) == 2
    assert min(case.truth["left_db"].values()) > floor + several.CLEAR_DB
