"""Letters from a worker to an analyser through a real broker: in order, once each, whatever happens to it."""

import asyncio
import itertools
import json
import os
import time
from dataclasses import replace

import nats
import pytest

from conftest import make_frames, make_rig, make_run
from creak.analysis import Plan, RigAnalysis
from creak.broker import Broker, StreamLimits
from creak.cli import run as command
from creak.codec import packed
from creak.codec.letters import envelope_of
from creak.digests import CLOSING, OPENING, Digest, Gatherer
from creak.records import AlarmRules, BaselineRules, Limits, RunStatus
from creak.sinks import fleet
from creak.sinks.database import open_store
from creak.sinks.fleet import LostRigError
from creak.sinks.journal import Journal
from creak.sinks.recorder import Recorder
from creak.sinks.stream import StreamSink, subject
from creak.sources.retold import BEFORE_ALL, retold
from creak.sources.stream import LetterReader
from creak.worker import Worker
from fleet_places import RIG as RIG_FILE_TEXT
from fleet_places import broker
from processes import wait_for
from store_places import PLACES, place
from test_worker import Frames

RIG = make_rig(2, lines=range(2, 8), name="a rig/1.x")
LIMITS = StreamLimits(600.0)


@pytest.fixture
def server(tmp_path):
    """Its messages are so small that every letter goes in parts."""
    with broker(tmp_path / "nats", largest=7_000) as made:
        yield made


@pytest.fixture
def connection(server):
    made = Broker(server.url, "t", LIMITS)
    wait_for(lambda: made.connected)
    yield made
    made.close()


def measure(connection, folder, run, realisations, whole_frames=False, pause=0.0):
    """A worker from begin to end; its sink."""
    sink = StreamSink(connection, "t", folder, retold, whole_frames=whole_frames)
    gatherer = Gatherer(run, whole_frames=whole_frames)
    source = Frames(run, make_frames(run, realisations, seed=3), pause=pause)
    worker = Worker(source, [Recorder(folder), sink], gatherer=gatherer)
    worker.start()
    wait_for(lambda: not worker.running)
    assert worker.end.status is RunStatus.COMPLETED
    return sink


def reader(connection, place=None, sequence=0, patience=60.0):
    subjects = (subject("t", kind, RIG.name) for kind in ("digests", "wanted"))
    return LetterReader(connection, *subjects, place, sequence, patience)


def read_all(letters, until):
    found = []
    wait_for(lambda: read_some(letters, found) or (found and found[-1].place >= until))
    return found


def read_some(letters, found):
    while (letter := letters.read(time.monotonic())) is not None:
        found.append(letter)
        letters.taken(letter)


def told_by(folder, run):
    return {d.index: d for _, d, _ in retold([folder / f"{RIG_FILE}-{run.id}.mcap"], BEFORE_ALL, **OVER)}


RIG_FILE = "a_rig_1.x"
OVER = {"whole_frames": False, "ended": True}


def run_of(name):
    return make_run(RIG, run_id=name, start=1)


def test_what_keeps_a_connection_from_being_tried_is_said(caplog):
    """Kills a worker that waits for its broker for ever and never says why."""
    made = Broker("nats://127.0.0.1:port", "t", LIMITS)
    try:
        wait_for(lambda: "the broker cannot be reached: nats: invalid connect url" in caplog.text)
        assert not made.connected
    finally:
        made.close()


def test_credentials_that_are_not_there_are_one_line(tmp_path, capsys):
    (tmp_path / "rig.toml").write_text(RIG_FILE_TEXT.format(name="beam"))
    (tmp_path / "creak.toml").write_text(
        '[stream]\ncredentials = "user.creds"\n[[rigs]]\nrig = "rig.toml"\n[rigs.source]\nkind = "stream"\n'
    )
    assert command(["analyse", str(tmp_path / "creak.toml")]) == 2
    found = capsys.readouterr().err
    assert found == f"creak: configuration: stream.credentials: '{tmp_path}/user.creds' is no file\n"


def test_letters_come_in_parts_in_order_and_hold_what_was_measured(connection, tmp_path):
    run = run_of("one")
    sink = measure(connection, tmp_path, run, 5)
    begun = sink.sent[0]
    found = read_all(reader(connection), (begun, CLOSING))
    assert [letter.digest.index for letter in found] == [OPENING, 0, 1, 2, 3, 4, CLOSING]
    assert found[0].run == run
    assert found[-1].end.status is RunStatus.COMPLETED
    again = told_by(tmp_path, run)
    for letter in found[1:-1]:
        assert packed(letter.digest) == packed(again[letter.digest.index])
    message = connection.next(subject("t", "digests", RIG.name), 0)
    assert envelope_of(message.headers).parts == 1
    message = connection.next(subject("t", "digests", RIG.name), message.sequence)
    assert envelope_of(message.headers).parts > 1


def test_a_broker_that_is_away_costs_neither_memory_nor_a_realisation(connection, server, tmp_path):
    """Kills a queue that grows for as long as the broker is away, and letters that it drops at its end."""
    measure(connection, tmp_path, run_of("one"), 2)
    server.kill()
    wait_for(lambda: not connection.connected)
    sink = measure(connection, tmp_path, run_of("two"), 40)
    assert len(sink._waiting) <= 16
    server.start()
    wait_for(lambda: connection.generation == 2)
    third = measure(connection, tmp_path, run_of("three"), 2)
    wait_for(lambda: third.sent[1] == CLOSING)
    found = read_all(reader(connection), third.sent)
    indices = [letter.digest.index for letter in found]
    assert indices == [OPENING, 0, 1, CLOSING, OPENING, *range(40), CLOSING, OPENING, 0, 1, CLOSING]
    assert all(b.previous == a.place for a, b in itertools.pairwise(found))


def test_what_the_broker_has_lost_is_told_again_on_request(connection, server, tmp_path):
    """Kills a reader that goes on over a gap, takes the later ones twice, or never goes back to them."""
    sink = measure(connection, tmp_path, run_of("one"), 6)
    delete(server, connection, {(sink.sent[0], 2), (sink.sent[0], 4)})
    letters = reader(connection)
    found = []
    wait_for(lambda: read_some(letters, found) or letters.waiting)
    assert [letter.digest.index for letter in found] == [OPENING, 0, 1]
    # The worker of the run is gone; the next one has the recording.
    later = StreamSink(connection, "t", tmp_path, retold)
    later.open(run_of("two"))
    wait_for(lambda: read_some(letters, found) or (found[-1].digest.index == OPENING and len(found) > 3))
    indices = [letter.digest.index for letter in found]
    assert indices == [OPENING, 0, 1, 2, 3, 4, 5, CLOSING, OPENING]
    assert not letters.missed
    assert letters.sequence > 0


def test_a_gap_that_nobody_can_fill_is_given_up_and_said(connection, server, tmp_path):
    sink = measure(connection, tmp_path, run_of("one"), 4)
    delete(server, connection, {(sink.sent[0], 1)})
    letters, found, missed = reader(connection, patience=1.0), [], []

    def read():
        while (letter := letters.read(time.monotonic())) is not None:
            found.append(letter.digest.index)
            missed.append(letters.missed)
            letters.taken(letter)
        return found[-1:] == [CLOSING]

    wait_for(read)
    assert found == [OPENING, 0, 2, 3, CLOSING]
    assert missed == [False, False, True, False, False]


def test_a_worker_that_comes_back_tells_the_end_of_the_run_that_was_killed(connection, tmp_path):
    """The journal may be older than what the broker has, never newer."""
    sink = measure(connection, tmp_path, run_of("one"), 4)
    (journal,) = tmp_path.glob("*.sent.json")
    begun = sink.sent[0]
    document = json.loads(journal.read_text())
    journal.write_text(json.dumps({**document, "sent": [begun, 1]}))
    later = measure(connection, tmp_path, run_of("two"), 1)
    found = read_all(reader(connection), later.sent)
    assert [letter.digest.index for letter in found] == [OPENING, 0, 1, 2, 3, CLOSING, OPENING, 0, CLOSING]


def test_a_power_cut_finds_a_whole_journal(tmp_path, monkeypatch):
    """Kills a name that the disk has before the content: the worker would not start until it is moved away."""
    path, synced, seen = tmp_path / "a.sent.json", {}, []
    sync, rename = os.fsync, os.replace

    def fsync(descriptor):
        found = os.fstat(descriptor)
        synced[found.st_ino] = found.st_size
        sync(descriptor)

    def replace_(new, old):
        seen.append(synced.get(os.stat(new).st_ino) == os.stat(new).st_size > 0)
        rename(new, old)
        synced.clear()

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", replace_)
    begun = Journal(path).begin("one")
    assert tmp_path.stat().st_ino in synced
    Journal(path).note((begun, 7))
    assert seen == [True, True]
    found = Journal(path)
    assert (found.sent, [run.begun for run in found.runs]) == ((begun, 7), [begun])


def test_a_file_that_is_being_written_is_told_up_to_its_last_whole_chunk(tmp_path, connection):
    """Kills a realisation that is told as incomplete because the file has grown while it was read."""
    run = run_of("one")
    measure(connection, tmp_path, run, 6)
    path = tmp_path / f"{RIG_FILE}-one.mcap"
    damaged = bytearray(path.read_bytes())
    middle = len(damaged) // 2
    damaged[middle : middle + 50] = bytes(50)
    path.write_bytes(damaged)
    told = [d for _, d, _ in retold([path], BEFORE_ALL, whole_frames=False, ended=False)]
    assert [d.index for d in told] == list(range(OPENING, len(told) - 1))
    assert 1 < len(told) < 6
    assert all(d.block is not None for d in told[1:])
    after = [d for _, d, _ in retold([path], BEFORE_ALL, **OVER)]  # of a run that is over, the rest is told
    whole = [d.index for d in after if d.block is not None]
    assert len(told) - 1 <= len(whole) < 6
    assert whole[-1] == 5
    assert after[-1].index == CLOSING


@pytest.fixture(params=PLACES)
def store(request, tmp_path):
    with place(request.param, tmp_path) as url:
        made = open_store(url)
        yield made
        made.close()


def owner(store, connection, analyser, window=3):
    with store.write() as transaction:
        epochs = fleet.share(transaction, analyser, [RIG.name], 0.2)
    plan = Plan(RIG, window, Limits(), AlarmRules(), BaselineRules())
    identity, _ = connection.identity()
    return RigAnalysis(store, connection, plan, epochs[RIG.name], "t", identity, 60.0, time.monotonic)


@pytest.mark.parametrize("whole_frames", [False, True])
def test_an_owner_that_was_paused_can_write_nothing_any_more(store, connection, tmp_path, whole_frames):
    """Kills a realisation that is counted by two owners; the second goes on where the first stood."""
    measure(connection, tmp_path, run_of("one"), 8, whole_frames=whole_frames)
    first = owner(store, connection, "analyser/one")
    for _ in range(4):
        assert first.step(0)
    time.sleep(0.3)  # it is paused for longer than its lease
    second = owner(store, connection, "analyser/two")
    assert second.reader.place == first.reader.place
    with pytest.raises(LostRigError):
        first.step(0)
    while second.step(0):
        pass
    assert second.monitor.counts.realisations == 8
    with store.read() as transaction:
        assert fleet.saved(transaction, RIG.name).position.blocks == 8


def test_rigs_are_shared_and_given_back(store):
    rigs = [f"rig {i}" for i in range(7)]

    def shared(analyser, idle=()):
        with store.write() as transaction:
            return set(fleet.share(transaction, analyser, rigs, 30.0, idle))

    assert shared("analyser/one") == set(rigs)
    assert shared("analyser/two") == set()  # nothing is free yet
    mine = shared("analyser/one", idle=rigs)
    assert len(mine) == 4
    assert shared("analyser/two") == set(rigs) - mine
    with store.write() as transaction:
        fleet.leave(transaction, "analyser/one")
    assert shared("analyser/two") == set(rigs)


def delete(server, connection, places):
    """Remove letters from the stream, as a broker does that loses them."""

    async def remove():
        client = await nats.connect(server.url)
        manager = client.jetstream()
        for sequence, headers in messages:
            if envelope_of(headers).place in places:
                await manager.delete_msg("t", sequence)
        await client.close()

    messages, at = [], 0
    while (message := connection.next(subject("t", "digests", RIG.name), at)) is not None:
        at = message.sequence
        messages.append((at, message.headers))
    asyncio.run(remove())


def test_a_digest_of_another_rig_is_not_taken(store, connection, tmp_path, caplog):
    """Kills an analyser that fails for ever, or mixes two rigs, if somebody gives two of them one name."""
    measure(connection, tmp_path, run_of("one"), 2)
    analysis = owner(store, connection, "analyser/one")
    analysis.plan = replace(analysis.plan, rig=make_rig(3, name=RIG.name))
    while analysis.step(0):
        pass
    assert analysis.monitor is None
    assert "another rig" in caplog.text
    assert isinstance(Digest(0, OPENING, 0).faults, tuple)
