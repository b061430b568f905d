"""A diagnosis whose candidates are tried elsewhere: in another order, in other processes, with a worker killed."""

import json
import pickle
import time
from functools import partial

import numpy as np
import pytest

import gap_rig
from creak.cli import run
from creak.cluster import connected
from creak.codec.diagnosis_json import diagnosis_json
from creak.gap.diagnose import diagnose
from creak.gap.view import see
from creak.mechanics.effects import Clearance, QuadraticDamping
from gap_recordings import CHAIN, RIG, recording

# Two laws at one place go through most stages: laws at places, linear elements beside them, pairs of laws.
EFFECTS = (Clearance(("2", "ground"), 4e4, 3e-4), QuadraticDamping(("2", "ground"), 60.0))
STAGES = {"trials_at", "_fitted", "best_sets", "refine", "_solved_part", "_jacobian_part"}


def document(each=map):
    return json.dumps(diagnosis_json(diagnose(RIG, CHAIN, recording(EFFECTS), each=each), None))


@pytest.fixture(scope="module")
def here():
    return document()


@pytest.fixture(scope="module")
def machines(tmp_path_factory):
    pytest.importorskip("distributed")
    from dask_machines import machines

    with machines(tmp_path_factory.mktemp("dask"), 2) as cluster:
        yield cluster


def test_what_is_found_hangs_on_neither_order_nor_place(here):
    """Kills candidates that share something, and results that are taken as they come."""
    stages = set()

    def copy(value):
        return pickle.loads(pickle.dumps(value))

    def backwards(function, items):
        stages.add(function.func.__name__)
        elsewhere = copy(function)
        return [copy(elsewhere(copy(item))) for item in reversed(list(items))][::-1]

    assert {cause["effect"] for cause in json.loads(here)["causes"]} == {effect.effect for effect in EFFECTS}
    assert document(backwards) == here
    assert stages >= STAGES


def test_pickling_lays_no_array_out_anew():
    """Kills views of other arrays: products of matrices may round otherwise where they are laid out otherwise."""
    data = recording(EFFECTS)
    view = see(RIG, CHAIN, data, 400)
    for record in (data, view):
        arrays = [value for value in vars(record).values() if isinstance(value, np.ndarray)]
        assert all(array.flags.c_contiguous for array in arrays)


def test_the_command_gives_the_same_document(machines, tmp_path, monkeypatch, capsys):
    gap_rig.write(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert run(gap_rig.simulate("truth.mcap")) == 0
    words = ["diagnose", "truth.mcap", "--model", "model.toml", "--json"]
    printed = []
    for more in ([], ["--scheduler", machines.address]):
        capsys.readouterr()
        assert run([*words, *more]) == 0
        printed.append(capsys.readouterr().out)
    assert printed[0] == printed[1]
    assert run([*words, "--scheduler", "127.0.0.1"]) == 2
    said = capsys.readouterr().err
    assert "--scheduler: 127.0.0.1: missing port number" in said
    assert said.count("\n") == 1


def test_tasks_are_applied_as_the_builtin_does(machines):
    """Results in the order of items, also of none, of a large argument, and of one that fails."""
    large = list(range(100_000))
    with connected(machines.address) as cluster:
        assert list(cluster.map(partial(pow, 3), range(20))) == [3**n for n in range(20)]
        assert list(cluster.map(partial(pow, 3), [])) == []
        for _ in range(2):
            assert list(cluster.map(partial(list.index, large), [7, 99_999, 0])) == [7, 99_999, 0]
        with pytest.raises(ValueError, match="is not in list"):
            list(cluster.map(partial(list.index, large), [7, -1]))


def test_a_killed_worker_changes_no_bit(here, machines):
    """It dies with its task and with what it was sent for all tasks; the other does it again."""
    finished = 0
    with connected(machines.address) as cluster:
        while cluster.threads < 2:
            time.sleep(0.1)

        def each(function, items):
            nonlocal finished
            for result in cluster.map(function, items):
                finished += 1
                if finished == 5:
                    machines.kill(machines.workers[0])
                yield result

        assert document(each) == here
        assert finished > 5
        assert cluster.threads == 1
