"""What the paper measured: rigs, models, runs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib.resources import as_file, files

from creak.config.model import load_model
from creak.config.rig import load_rig
from creak.mechanics.beam import Beam
from creak.mechanics.effects import CubicStiffness
from creak.mechanics.structure import Link, Lumped, PointMass
from creak.mechanics.system import assemble
from creak.multisine import grid_lines
from creak.network import node_to_node
from creak.realisations import Collector
from creak.records import (
    AlarmState,
    Complex,
    Estimate,
    Frame,
    FrameStatus,
    Limits,
    Node,
    Rig,
    Run,
    RunEnd,
    RunStatus,
    Scope,
)
from creak.sinks.protocol import Sink
from creak.sources.simulated import SimulatedRig
from creak.statistics import Sums
from creak.worker import drive

SNR_DB = 40.0
SEED = 1

SPRING_UNIT = 3.5e7
"""N/m^3 that stand for the paper's ``k_n = 1``, whose unit it does not give: its controller adds ``k_n`` times the
cubed sensor signal to a current. Calibrated so that node 3 is about 10 dB clear, as in the paper's figure 15."""

LIMITS = Limits(windows=1, exceeding=1)
"""The beam has two realisations, so one window decides; level and significance are the usual ones."""

Progress = Callable[[str, int], Sink]
"""Gives a sink that shows how a run of this name and number of frames comes along."""


@dataclass(frozen=True, eq=False)
class Result:
    """What one run gave.

    Parameters
    ----------
    rig : Rig
    estimate : Estimate
        Of the whole run.
    alarms : mapping of str to AlarmState
    S : array, (F, n, n)
        BLA from the inputs to the nodes.
    G_u, G_y : array, (F, n), (F, n, n)
        BLA from node to node.
    """

    rig: Rig
    estimate: Estimate
    alarms: Mapping[str, AlarmState]
    S: Complex
    G_u: Complex
    G_y: Complex


def three_masses(spring: float) -> tuple[Rig, Lumped]:
    """Rig and model of the simulation study.

    Parameters
    ----------
    spring : float
        Cubic stiffness between mass 3 and the ground, N/m^3; 1e8 in the paper.
    """
    lines = grid_lines("full", (5.0, 100.0), 5000.0, 8192)
    nodes = tuple(Node(name, output="m", input="N") for name in "123")
    rig = Rig("three-mass", 5000.0, 8192, 2, lines, nodes, network=(("1", "2"), ("2", "3")))
    masses = tuple(PointMass(name, mass) for name, mass in zip("123", (1.0, 0.8, 1.2), strict=True))
    ends = (("1", "ground"), ("2", "1"), ("3", "2"), ("3", "ground"))
    links = tuple(Link(pair, k, 8.0) for pair, k in zip(ends, (2e4, 3.5e4, 5e4, 8e4), strict=True))
    return rig, Lumped(masses, links, _spring(spring))


def beam(spring: float) -> tuple[Rig, Beam]:
    """Rig and model that stand for the experiment.

    Parameters
    ----------
    spring : float
        Cubic stiffness between node 3 and the ground, N/m^3.
    """
    with as_file(files("creak") / "examples" / "beam") as example:
        rig, model = load_rig(example / "rig.toml"), load_model(example / "model.toml")
    assert isinstance(model, Beam)
    return rig, replace(model, effects=_spring(spring))


def response(rig: Rig, model: Lumped | Beam) -> Complex:
    """True response matrix of the linear part at the excited lines, ``(F, n, n)``."""
    return assemble(model, rig).response(rig.frequencies)


def run_three_masses(progress: Progress) -> dict[str, Result]:
    """Section 5: ten realisations, the last 2 of 4 periods, 50 N rms; linear, and with the cubic spring."""
    return {
        name: _run(*three_masses(spring), 10, 2, 50.0, progress, f"three masses, {name}")
        for name, spring in (("linear", 0.0), ("cubic", 1e8))
    }


def run_beam(progress: Progress) -> dict[str, Result]:
    """Section 6: two realisations of three experiments, the last 3 of 6 periods, 0.02 A rms, springs 0, 1, 10."""
    return {f"k={k}": _run(*beam(k * SPRING_UNIT), 2, 3, 0.02, progress, f"beam, k = {k}") for k in (0, 1, 10)}


def _spring(coefficient: float) -> tuple[CubicStiffness, ...]:
    return (CubicStiffness(("3", "ground"), coefficient),) if coefficient else ()


def _run(
    rig: Rig, model: Lumped | Beam, realisations: int, steady: int, rms: float, progress: Progress, name: str
) -> Result:
    source = SimulatedRig(
        rig,
        model,
        steady_periods=steady,
        rms=rms,
        seed=SEED,
        snr_db=SNR_DB,
        realisations=realisations,
        run_id=name,
        window=realisations,
        limits=LIMITS,
        substeps=1,
    )
    gathered = _Gathered()
    shown = progress(name, realisations * rig.q * source.run.periods)
    monitor, end = drive(source, [gathered, shown])
    if end.status is RunStatus.INTERRUPTED:
        raise KeyboardInterrupt
    assert gathered.estimate is not None
    assert gathered.sums is not None
    G_u, G_y = node_to_node(gathered.sums, rig)
    return Result(rig, gathered.estimate, dict(monitor.alarms), gathered.sums.S, G_u, G_y)


class _Gathered:
    """Sink that keeps the newest estimate of the run, and the sums behind it, of which estimates have no BLA."""

    def __init__(self) -> None:
        self.estimate: Estimate | None = None
        self.sums: Sums | None = None
        self._collector: Collector | None = None

    def open(self, run: Run) -> None:
        self._collector = Collector(run)

    def take(self, record: object) -> None:
        if isinstance(record, Estimate) and record.scope is Scope.RUN:
            self.estimate = record
        elif isinstance(record, Frame) and record.status is FrameStatus.ACCEPTED and self._collector is not None:
            realisation = self._collector.take(record).realisation
            if realisation is not None:
                sums = Sums.of(realisation.spectra, len(record.u))
                self.sums = sums if self.sums is None else self.sums + sums

    def tick(self, now: float) -> None:
        pass

    def close(self, end: RunEnd) -> None:
        pass
