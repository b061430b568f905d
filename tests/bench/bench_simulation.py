"""Time stepping against pyvib's and numpy's, the steady-state solver against time stepping, and how they scale.

Everything that makes up a ratio is measured in turn, again and again, so that a loaded machine hits all alike;
shown are medians. On one core processor time counts, on all of them elapsed time. ``--pyvib FOLDER`` is a checkout
of pyvib; without it a Newmark of the same scheme in plain numpy, written below, stands for it.
"""

import itertools
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache, partial

import numpy as np
from figures import options, show_all

from creak.mechanics.newmark import Stepper
from creak.mechanics.steady import simulate_steady
from creak.mechanics.system import assemble
from creak.multisine import realisation
from creak.paper.studies import three_masses
from creak.sources.simulated import SimulatedRig

SPRING, RMS, REALISATIONS, STEADY = 1e8, 50.0, 10, 2  # the paper's study
CORES = os.cpu_count() or 1
SLOW = 4000  # samples that the Python loops are given
PAIRED = 3  # experiments that are stepped: the cost is linear in their number, as the table of costs shows
FINEST = 64  # steps a sample of the reference


def numpy_newmark(mass, damping, stiffness, direction, spring, forces, h):
    """Average acceleration with Newton on all coordinates; one cubic spring along a direction.

    Parameters
    ----------
    mass, damping, stiffness : array, (dof, dof)
    direction : array, (dof,)
    spring : float
        N/m^3.
    forces : array, (steps, dof)
    h : float
        Step, s.

    Returns
    -------
    array, (steps, dof)
        Displacements from rest.
    """
    out = np.zeros(forces.shape)
    x = v = np.zeros(len(mass))
    a = np.linalg.solve(mass, forces[0])
    effective = stiffness + 2 / h * damping + 4 / h**2 * mass
    for n in range(1, len(forces)):
        old_x, old_v, old_a = x, v, a
        x = old_x + h * old_v + h**2 / 2 * old_a
        for _ in range(50):
            a = 4 / h**2 * (x - old_x - h * old_v) - old_a
            v = old_v + h / 2 * (old_a + a)
            d = direction @ x
            rest = forces[n] - mass @ a - damping @ v - stiffness @ x - spring * d**3 * direction
            if np.linalg.norm(rest) < 1e-10:
                break
            tangent = effective + 3 * spring * d**2 * np.outer(direction, direction)
            x = x + np.linalg.solve(tangent, rest)
        out[n] = x
    return out


def pyvib_newmark(mass, damping, stiffness, direction, spring, forces, h):
    """The same by pyvib."""
    from pyvib.newmark import Newmark
    from pyvib.nonlinear_elements_newmark import Polynomial

    solver = Newmark(mass, damping, stiffness, nls=[Polynomial(exp=3, w=direction, k=spring)])
    return solver.integrate(forces, h)[0]


@cache
def study(spring, samples=8192):
    """Rig, system and inputs ``(30, 3, N)`` of the paper's simulation study, at another number of samples too."""
    rig, model = three_masses(spring)
    rig = replace(rig, period_samples=samples, lines=tuple(range(rig.lines[0], rig.lines[-1] * samples // 8192)))
    u = np.concatenate([realisation(rig, RMS, 1, m) for m in range(REALISATIONS)])
    return rig, assemble(model, rig), u


def in_turn(repetitions, clock, **works):
    """Seconds of every work in every repetition, ``{name: (repetitions,)}``; one round before does not count."""
    taken = {name: [] for name in works}
    for _ in range(repetitions + 1):
        for name, work in works.items():
            begun = clock()
            work()
            taken[name].append(clock() - begun)
    return {name: np.array(times[1:]) for name, times in taken.items()}


ONE_CORE, ALL_CORES = time.process_time, time.perf_counter


def stepping(repetitions, pyvib):
    """Rows: a step of each, and how many of ours fit into it."""
    rig, system, u = study(SPRING)
    args = system.mass, system.damping, system.stiffness, system.incidence[:, 0], SPRING
    forces = np.ascontiguousarray((system.inputs @ u[0]).T[:SLOW])
    peers = {"numpy": numpy_newmark} | ({"pyvib": pyvib_newmark} if pyvib else {})

    def whole(threads):
        _, model = three_masses(SPRING)
        source = SimulatedRig(
            rig,
            model,
            steady_periods=STEADY,
            rms=RMS,
            seed=1,
            realisations=REALISATIONS,
            substeps=1,
            threads=threads,
        )
        for _ in source.frames():
            pass

    stepper = Stepper(system, rig.sample_rate, 1, rig.hold)
    ours = next(stepper.experiment(u[0], 1))[:, :SLOW]
    for name, peer in peers.items():
        x = peer(*args, forces, 1 / rig.sample_rate) @ system.outputs.T
        assert np.abs(x.T - ours).max() < 1e-8 * np.abs(ours).max(), f"{name} gives another motion"
    peers = {name: partial(peer, *args, forces, 1 / rig.sample_rate) for name, peer in peers.items()}
    alone = in_turn(
        repetitions,
        ONE_CORE,
        **peers,
        ours=lambda: [None for e in range(6) for _ in stepper.experiment(u[e], 4)],
    )
    slowest = "pyvib" if pyvib else "numpy"
    study_ = in_turn(repetitions, ALL_CORES, one=partial(whole, 1), all=partial(whole, CORES), peer=peers[slowest])
    steps = len(u) * (rig.transient_periods + STEADY) * rig.period_samples
    a_step = {name: alone[name] / (SLOW - 1) for name in peers}
    a_step["creak, one core"] = alone["ours"] / (6 * 4 * rig.period_samples)
    rows = [(name, t, a_step[slowest]) for name, t in a_step.items()]
    peer = study_["peer"] / (SLOW - 1)
    rows.append(("creak, whole study, one thread, elapsed", study_["one"] / steps, peer))
    rows.append((f"creak, whole study, {CORES} threads, elapsed", study_["all"] / steps, peer))
    return [
        {"a step of": name, "µs": 1e6 * float(np.median(t)), "times faster": float(np.median(slow / t))}
        for name, t, slow in rows
    ]


def error_db(y, reference):
    """Power of the difference relative to that of the response, at the worst node, dB."""
    ratio = np.sum((y - reference) ** 2, axis=-1) / np.sum(reference**2, axis=-1)
    return float(10 * np.log10(ratio.max()))


def stepped(system, rig, u, steps, periods):
    """Last period of one experiment; two numbers of steps a sample are extrapolated, as `creak simulate` does."""
    last = [list(Stepper(system, rig.sample_rate, s, rig.hold).experiment(u, periods))[-1] for s in steps]
    return last[0] if len(last) == 1 else (4 * last[1] - last[0]) / 3


def cheapest(system, rig, u, reference, limit, ways):
    """Steps a sample and periods with which time stepping comes below a limit at least cost."""
    tried = [(steps, periods) for steps in ways for periods in range(2, 7)]
    for steps, periods in sorted(tried, key=lambda way: sum(way[0]) * way[1]):
        if error_db(stepped(system, rig, u, steps, periods), reference) <= limit:
            return steps, periods
    raise SystemExit(f"time stepping does not come below {limit} dB")


def steady_state(repetitions, experiments):
    """Rows: the solver against the cheapest time stepping that is as accurate as is asked for.

    Newmark as it is (one number of steps a sample) and extrapolated (two numbers).
    """
    rows = []
    with ThreadPoolExecutor(CORES) as pool:
        for spring, limit in itertools.product((SPRING, 10 * SPRING), (-60.0, -80.0, -100.0)):
            rig, system, u = study(spring)
            u = u[:experiments]
            reference = stepped(system, rig, u[0], (FINEST // 2, FINEST), 8)
            solve = partial(
                simulate_steady, system, u, rig.sample_rate, rig.hold, tolerance=0.3 * 10 ** (limit / 20)
            )
            solved = solve()
            assert solved.settled
            solved_db = error_db(solved.y[0], reference)
            assert solved_db <= limit
            powers = [2**k for k in range(7)]
            plain = cheapest(system, rig, u[0], reference, limit, [(s,) for s in powers]) if limit > -100 else None
            pair = cheapest(system, rig, u[0], reference, limit, [(s, 2 * s) for s in powers[:5]])
            march = partial(march_of, system, rig, u)
            threads = in_turn(repetitions, ALL_CORES, one=solve, all=partial(solve, each=pool.map))
            taken = in_turn(
                repetitions,
                ONE_CORE,
                solved=solve,
                pair=lambda march=march, pair=pair: [march(pair, e) for e in range(PAIRED)],
                plain=lambda march=march, plain=plain: plain and march(plain, 0),
            )
            rows.append(
                {
                    "spring": spring,
                    "asked dB": limit,
                    "solved dB": solved_db,
                    "solved ms": 1e3 * float(np.median(taken["solved"])) / experiments,
                    "Newmark": f"{plain[0][0]} × {plain[1]}" if plain else "-",
                    "slower": float(np.median(experiments * taken["plain"] / taken["solved"])) if plain else "-",
                    "extrapolated": f"{pair[0][0]}, {pair[0][1]} × {pair[1]}",
                    "slower ": float(np.median(experiments / PAIRED * taken["pair"] / taken["solved"])),
                    f"{CORES} cores": float(np.median(threads["one"] / threads["all"])),
                }
            )
    return rows


def march_of(system, rig, u, way, e):
    return stepped(system, rig, u[e], *way)


def scaling(repetitions):
    """Rows: nanoseconds a sample of an experiment, at other numbers of both."""
    rows = []
    for experiments, samples in ((3, 8192), (6, 8192), (12, 8192), (24, 8192), (6, 2048), (6, 4096), (6, 16384)):
        rig, system, u = study(SPRING, samples)
        u = u[:experiments]
        stepper = Stepper(system, rig.sample_rate, 1, rig.hold)
        taken = in_turn(
            repetitions,
            ONE_CORE,
            stepped=lambda stepper=stepper, u=u: [None for one in u for _ in stepper.experiment(one, 1)],
            solved=partial(simulate_steady, system, u, rig.sample_rate, rig.hold, oversampling=1),
        )
        a_sample = {name: 1e9 * float(np.min(t)) / (experiments * samples) for name, t in taken.items()}
        rows.append(
            {
                "experiments": experiments,
                "samples": samples,
                "stepped ns a sample": a_sample["stepped"],
                "solved ns a sample": a_sample["solved"],
            }
        )
    return rows


def starts():
    """Rows: seconds from the start of a process to its first simulated period, before and after code is cached."""
    code = (
        "import time; begun = time.perf_counter()\n"
        "import creak.sources.simulated, creak.paper.studies as s; loaded = time.perf_counter()\n"
        "rig, model = s.three_masses(1e8)\n"
        "source = s.SimulatedRig(rig, model, steady_periods=1, rms=50.0, seed=1, realisations=1, substeps=1)\n"
        "next(source.frames())\n"
        "print(loaded - begun, time.perf_counter() - loaded)"
    )
    rows = []
    with tempfile.TemporaryDirectory(prefix="creak-numba-") as folder:
        environment = os.environ | {"NUMBA_CACHE_DIR": folder}
        for name in ("first, nothing compiled", "second", "third"):
            done = subprocess.run(
                [sys.executable, "-c", code], env=environment, check=True, capture_output=True, text=True
            )
            loading, first = map(float, done.stdout.split())
            rows.append({"start": name, "imports s": loading, "first realisation s": first})
    return rows


def main():
    given = options(__doc__.splitlines()[0], repetitions=5, experiments=30, pyvib="")
    if given.pyvib:
        sys.path.insert(0, given.pyvib)
    show_all(
        {
            "time stepping, three masses with the paper's cubic spring": stepping(given.repetitions, given.pyvib),
            "steady state at equal accuracy (stepped: steps a sample × periods)": steady_state(
                given.repetitions, given.experiments
            ),
            "cost of one sample of one experiment": scaling(given.repetitions),
            "starts": starts(),
        },
        given.json,
    )


if __name__ == "__main__":
    main()
