"""What a restart needs of the sums: written once each, whole or not at all, and read to the last bit."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
import sqlalchemy as sa

from conftest import make_frames, make_rig, make_run
from creak.codec import memory_bytes, packed
from creak.monitor import Monitor
from creak.records import Estimate
from creak.sinks import kept_sums, operator_tables
from creak.sinks.kept_sums import NOTHING, fleet_sums, state_sums
from creak.sinks.restart import saved_memory
from store_records import opened

WINDOW = 3
RUN = make_run(make_rig(2, name="beam"), window=WINDOW)
EACH = 2 * RUN.periods  # frames a realisation


def told(monitor, frames):
    return [packed_estimate(o) for f in frames for o in monitor.take(f) if isinstance(o, Estimate)]


def packed_estimate(estimate):
    columns = [getattr(estimate.spectra, name) for name in type(estimate.spectra).__dataclass_fields__]
    return repr(estimate.nodes), *(None if column is None else column.tobytes() for column in columns)


def bits(value):
    """All that a record holds, to the last bit."""
    if isinstance(value, np.ndarray):
        return value.strides, value.tobytes()
    if isinstance(value, tuple):
        return tuple(map(bits, value))
    if isinstance(value, float):
        return value.hex()
    if is_dataclass(value):
        return tuple(bits(getattr(value, field.name)) for field in fields(value))
    return value


def realisations(count, noise=1e-2, cubic=None):
    frames = make_frames(RUN, count, noise=noise, cubic=cubic)
    return [frames[EACH * m : EACH * (m + 1)] for m in range(count)]


def slots(store, table):
    with store.read() as connection:
        return sorted(connection.execute(sa.select(table.c.slot).where(table.c.rig == "beam")).scalars())


@pytest.mark.parametrize(("noise", "cubic"), [(1e-2, None), (1e-7, 4)])
def test_a_restart_after_any_realisation_goes_on_to_the_last_bit(store, noise, cubic):
    """Kills sums of the run that were added in another order, and blocks about a matrix that is out of date."""
    monitor, known, abouts = Monitor(RUN), NOTHING, set()
    parts = realisations(9, noise, cubic)
    for m, frames in enumerate(parts):
        told(monitor, frames)
        state = monitor.checkpoint
        made = kept_sums.changes(known, WINDOW, state.memory.blocks, state.whole)
        with store.write() as connection:
            kept_sums.write(connection, fleet_sums, "beam", made)
        known = made.after
        abouts.add(id(known.about))
        with store.read() as connection:
            kept = kept_sums.read(connection, fleet_sums, "beam")
        assert bits(kept.blocks) == bits(state.memory.blocks)
        assert bits(kept.whole) == bits(state.whole)
        memory = replace(state.memory, blocks=kept.blocks)
        later = Monitor.resumed(RUN, replace(state, memory=memory, whole=kept.whole))
        live = Monitor.resumed(RUN, state)
        rest = [frame for part in parts[m + 1 :] for frame in part]
        assert told(later, rest) == told(live, rest)
        again = kept_sums.changes(kept.known, WINDOW, kept.blocks, kept.whole)
        assert again.rows == ()  # whoever has read it knows what is there
    assert len(abouts) == (1 if cubic is None else 2)


def test_a_realisation_writes_one_block_and_the_run_once_in_a_window(store):
    """Kills a store that is written anew in full at every realisation."""
    monitor, known, rows = Monitor(RUN), NOTHING, []
    for frames in realisations(8):
        told(monitor, frames)
        made = kept_sums.changes(known, WINDOW, monitor.memory.blocks, monitor.checkpoint.whole)
        with store.write() as connection:
            kept_sums.write(connection, fleet_sums, "beam", made)
        known = made.after
        rows.append(sorted(slot for slot, _, _ in made.rows))
    assert rows == [[-2, -1, 1], [2], [3], [-1, 4], [5], [6], [-1, 7], [8]]
    assert slots(store, fleet_sums) == [-2, -1, 6, 7, 8]
    with store.write() as connection:
        kept_sums.forget_whole(connection, fleet_sums, "beam")
    assert slots(store, fleet_sums) == [-2, 6, 7, 8]


def test_a_service_that_was_killed_goes_on_as_it_would_have(store):
    """Kills a window that is empty, of another order, or of other bits after a restart."""
    monitor, sink = Monitor(RUN), opened(store, RUN)
    assert saved_memory(store, "beam") is None
    for frames in realisations(7):
        told(monitor, frames)
        sink.save(monitor.memory)
        assert bits(saved_memory(store, "beam")) == bits(monitor.memory)
    assert slots(store, state_sums) == [-2, 5, 6, 7]
    later = replace(RUN, id="later", start=monitor.time)
    again, sink = Monitor(later, saved_memory(store, "beam")), opened(store, later)
    told(again, make_frames(later, 1, seed=8))
    sink.save(again.memory)
    assert bits(saved_memory(store, "beam")) == bits(again.memory)
    assert saved_memory(store, "bench") is None


def test_a_save_that_fails_halfway_leaves_the_state_before_it_and_is_made_good(store, monkeypatch):
    """Kills a window whose newest block is missing because it was thought to be written."""
    monitor, sink = Monitor(RUN), opened(store, RUN)
    before = None
    write = kept_sums.write
    for m, frames in enumerate(realisations(6)):
        told(monitor, frames)
        if m == 3:

            def torn(connection, *given):
                write(connection, *given)
                raise RuntimeError("power failure")

            monkeypatch.setattr(kept_sums, "write", torn)
            with pytest.raises(RuntimeError, match="power failure"):
                sink.save(monitor.memory)
            monkeypatch.undo()
            assert bits(saved_memory(store, "beam")) == before
        else:
            sink.save(monitor.memory)
            before = bits(saved_memory(store, "beam"))
            assert before == bits(monitor.memory)


def test_a_state_as_version_5_wrote_it_is_taken_up_and_replaced(store):
    monitor, sink = Monitor(RUN), opened(store, RUN)
    *parts, last = realisations(5)
    for frames in parts:
        told(monitor, frames)
    memory = monitor.memory
    ring = [(k % WINDOW, k, packed(block)) for k, block in enumerate(memory.blocks, 7)]
    rows = [*ring, (-1, 9, packed(monitor.checkpoint.whole))]
    with store.write() as connection:
        states = {"rig": "beam", "run": RUN.id, "time": memory.time, "payload": memory_bytes(memory)}
        connection.execute(sa.insert(operator_tables.states).values(states))
        old = [{"rig": "beam", "slot": s, "number": n, "payload": data} for s, n, data in rows]
        connection.execute(sa.insert(fleet_sums), old)
    assert bits(saved_memory(store, "beam")) == bits(memory)
    with store.read() as connection:
        kept = kept_sums.read(connection, fleet_sums, "beam")
    assert bits(kept.blocks) == bits(memory.blocks)
    assert bits(kept.whole) == bits(monitor.checkpoint.whole)
    told(monitor, last)
    sink.save(monitor.memory)
    assert bits(saved_memory(store, "beam")) == bits(monitor.memory)
    with store.write() as connection:
        made = kept_sums.changes(kept.known, WINDOW, monitor.memory.blocks, monitor.checkpoint.whole)
        kept_sums.write(connection, fleet_sums, "beam", made)
    assert slots(store, fleet_sums) == [-2, -1, 1, 2, 3]


def test_blocks_without_a_common_matrix_keep_their_own():
    monitor = Monitor(RUN)
    for frames in realisations(2):
        told(monitor, frames)
    first, second = monitor.memory.blocks
    other = replace(second, sums=replace(second.sums, about=np.array(second.sums.about)))
    made = kept_sums.changes(NOTHING, WINDOW, (first, other))
    assert [(slot, number) for slot, number, _ in made.rows] == [(1, 1), (2, 2)]
    assert [data for _, _, data in made.rows] == [packed(first), packed(other)]
