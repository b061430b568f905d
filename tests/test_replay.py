"""Several recordings of one rig: what they have in common, in this process and on a Dask cluster."""

import json
import socket
import sys
import time
from concurrent.futures import as_completed
from dataclasses import replace
from functools import partial
from operator import add

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import make_rig, make_run
from creak.cli import run
from creak.cluster import Here, connected, tree
from creak.errors import ConfigurationError, InputError, RecordingError, ServiceError
from creak.multisine import realisation
from creak.records import Frame
from creak.replay import in_order, replayed
from creak.sinks.recorder import Recorder
from creak.sources.recording import Recording, recordings
from creak.worker import drive
from recorded import exact

RIG = make_rig(3, samples=256, lines=range(2, 62), transient=1)
DAY = 86_400_000_000_000


class Played:
    """A linear structure with noise, realisations `first` to `end`, as a source."""

    live = False

    def __init__(self, name, first, end, rig=RIG, start=0):
        self.run = replace(make_run(rig, steady=2), id=name, start=start)
        self._these = range(first, end)

    def frames(self):
        rig = self.run.rig
        A = np.eye(3) + 0.2 * np.ones((3, 3))
        for index, m in enumerate(self._these):
            rng = np.random.default_rng(m)
            for c, u in enumerate(realisation(rig, 1.0, 7, m)):
                for p in range(3):
                    y = A @ u + 1e-2 * rng.standard_normal(u.shape)
                    at = self.run.start + round(((index * 3 + c) * 3 + p) * rig.period_ns)
                    yield Frame(index, c, p, at, u, y)

    def close(self):
        pass


def record(path, *arguments, **other):
    drive(Played(*arguments, **other), [Recorder(path)])
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Eight recordings of three realisations each, a day apart, and one of all of them."""
    folder = tmp_path_factory.mktemp("runs")
    for k in range(8):
        record(folder / f"day-{k}.mcap", f"run {7 - k}", 3 * k, 3 * k + 3, start=k * DAY)
    record(folder / "whole.mcap", "whole", 0, 24)
    return folder


@pytest.fixture(scope="module")
def days(folder):
    return [folder / f"day-{k}.mcap" for k in range(8)]


def replay_json(capsys, *arguments):
    code = run(["replay", "--json", *map(str, arguments)])
    captured = capsys.readouterr()
    assert code == 0, captured.err
    return captured.out


@given(st.integers(1, 200))
def test_a_tree_keeps_the_order_and_holds_little(count):
    """Its shape must follow from the count alone, and breadth first would hold every recording's sums at once."""
    held = most = 0

    def leaf(index):
        nonlocal held, most
        held += 1
        most = max(most, held)
        return [index], 0

    def combine(a, b):
        nonlocal held
        held -= 1
        return a[0] + b[0], 1 + max(a[1], b[1])

    order, depth = tree(count, leaf, combine)
    assert order == list(range(count))
    assert depth == (count - 1).bit_length()
    assert most <= depth + 1


def test_recordings_together_are_the_whole(days, folder, capsys):
    """Sums of sums against the same frames in one run; merged in another order they round differently."""
    together = json.loads(replay_json(capsys, *days))
    whole = json.loads(replay_json(capsys, folder / "whole.mcap"))
    for key in ("frames", "rejected_frames", "experiments", "realisations", "transient_frames", "located"):
        assert together[key] == whole[key]
    for one, other in zip(together["nodes"], whole["nodes"], strict=True):
        for key, value in one.items():
            assert other[key] == (pytest.approx(value, rel=1e-9) if isinstance(value, float) else value)
    told = together["recordings"]
    assert [part["files"] for part in told] == [[path.name] for path in days]
    assert [part["realisations"] for part in told] == [3] * 8


def test_the_order_of_files_changes_no_bit(days, folder, capsys):
    """A shell sorts names as it likes; what counts is when recordings began."""
    assert replay_json(capsys, *days[::-1]) == replay_json(capsys, *days[3:], *days[:3])


def test_recordings_of_other_rigs_are_refused(days, tmp_path, capsys):
    other = record(tmp_path / "other.mcap", "other", 0, 1, rig=replace(RIG, lines=RIG.lines[1:]), start=DAY)
    assert run(["replay", str(days[0]), str(other)]) == 2
    said = capsys.readouterr().err
    assert "other.mcap: is of another run than" in said
    assert "differs in lines" in said
    assert said.count("\n") == 1


def test_errors_cross_processes_whole():
    """An exception with arguments of its own is not made anew of its text."""
    import pickle

    error = pickle.loads(pickle.dumps(ConfigurationError("rig.toml", "band", "is empty")))
    assert (str(error), error.key) == ("rig.toml: band: is empty", "band")


def test_what_a_scheduler_needs_is_said_in_one_line(days, capsys, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        free = taken.getsockname()[1]
    for address, why in (
        (f"tcp://127.0.0.1:{free}", "no scheduler answers within"),
        ("127.0.0.1", "missing port number"),
        ("nonsense://x:1", "unknown address scheme"),
    ):
        assert run(["replay", str(days[0]), "--scheduler", address]) == 2
        said = capsys.readouterr().err
        assert f"--scheduler: {address}: {why}" in said
        assert said.count("\n") == 1
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert run(["replay", str(days[0]), "--scheduler", "127.0.0.1:1"]) == 2
    assert "install creak[dask]" in capsys.readouterr().err


@pytest.fixture(scope="module")
def machines(tmp_path_factory):
    pytest.importorskip("distributed")
    from dask_machines import machines

    with machines(tmp_path_factory.mktemp("dask"), 2) as cluster:
        yield cluster


def reduced(place, days, done=lambda: None):
    parts = [recording.paths for recording in in_order(recordings(*days))]
    return place.reduce(partial(replayed, method="plain"), parts, add, done)


def test_a_killed_worker_changes_no_bit(days, machines):
    """One of two workers is killed with what it has summed and what it is at; the other does it again."""
    expected = exact(reduced(Here(), days).block)
    with connected(machines.address) as cluster:
        while cluster.threads < 2:
            time.sleep(0.1)
        assert exact(reduced(cluster, days).block) == expected
        finished = 0

        def kill_one():
            nonlocal finished
            finished += 1
            if finished == 3:
                machines.kill(machines.workers[0])

        assert exact(reduced(cluster, days, kill_one).block) == expected
        assert finished == len(days)
        assert cluster.threads == 1


def test_a_cluster_is_an_executor_too(machines):
    """What blind trials are spread by; an answer belongs to its own question."""
    with connected(machines.address) as cluster:
        pool = cluster.executor()
        asked = {pool.submit(pow, 3, n): n for n in range(20)}
        assert {asked[done]: done.result() for done in as_completed(asked)} == {n: 3**n for n in range(20)}


def test_the_command_gives_the_same_document(days, machines, capsys):
    assert replay_json(capsys, *days, "--scheduler", machines.address) == replay_json(capsys, *days)
    assert replay_json(capsys, days[2], "--scheduler", machines.address) == replay_json(capsys, days[2])


def test_what_fails_on_a_worker_is_told_as_here(days, machines, tmp_path):
    gone = tmp_path / "gone.mcap"
    with connected(machines.address) as cluster, pytest.raises(RecordingError, match=r"gone.mcap: cannot be read"):
        cluster.reduce(replayed, [(days[0],), (gone,), (days[1],)], add, lambda: None)


def test_a_scheduler_that_dies_ends_the_run(days, machines):
    """Otherwise the command would wait for an answer that never comes."""
    with pytest.raises(ServiceError, match="the scheduler has gone"), connected(machines.address) as cluster:
        reduced(cluster, days, lambda: machines.kill(machines.scheduler))
    with pytest.raises(InputError, match="no scheduler answers"), connected(machines.address):
        pass


def test_a_recording_alone_is_what_its_monitor_made_of_it(days):
    """The sums that merge must be those that the pipeline judged."""
    from creak.judgement import judged
    from creak.records import Scope
    from creak.replay import Newest

    newest = Newest()
    drive(Recording(days[0]), [newest])
    alone = replayed((days[0],))
    assert exact(judged(RIG, alone.block, Scope.RUN, alone.recordings[0])) == exact(newest.estimate)
