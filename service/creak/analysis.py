"""One rig of the fleet in the hands of its owner: letters in, results and state out, in one transaction each.

Whatever goes wrong with a transaction, what is in memory is thrown away and read back: what the store holds is the
only truth, so a letter has its effects once however often it is tried.
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import sqlalchemy as sa

from creak import codec
from creak.alarm_records import AlarmRules, BaselineRules, Clock, Conflict, Limits
from creak.broker import Broker
from creak.codec.letters import Letter
from creak.digests import Outcome, summed
from creak.errors import RecordingError
from creak.monitor import Checkpoint, Monitor
from creak.records import AlarmChange, Estimate, Fault, FaultKind, Rig, Run
from creak.sinks import actions, fleet, kept_sums
from creak.sinks.actions import Asked
from creak.sinks.alarm_rows import told_last
from creak.sinks.database import Store
from creak.sinks.fleet import Position
from creak.sinks.store import StoreSink
from creak.sinks.stream import subject
from creak.sources.stream import LetterReader

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Plan:
    """How a rig is to be judged, as the service file says."""

    rig: Rig
    window: int
    limits: Limits
    alarms: AlarmRules
    baseline: BaselineRules

    def applied(self, run: Run) -> Run:
        """The run of a worker, with these rules."""
        rules = {"limits": self.limits, "alarms": self.alarms, "baseline": self.baseline}
        return replace(run, window=self.window, source="stream", **rules)  # type: ignore[arg-type]


class _Joined:
    """A store whose writes all join the transaction at hand."""

    def __init__(self) -> None:
        self.connection: sa.Connection | None = None

    @contextmanager
    def write(self, durable: bool = True) -> Iterator[sa.Connection]:
        assert self.connection is not None
        yield self.connection


class RigAnalysis:
    """Takes the letters of one rig, as long as this process owns it.

    Parameters
    ----------
    store : Store
    broker : Broker
    plan : Plan
    epoch : int
        Of the ownership (:func:`creak.sinks.fleet.share`).
    stream : str
        Name of the stream.
    identity : str
        Of the stream as it is now (`Broker.identity`).
    patience : float
        Seconds after which a gap is given up.
    clock : callable
        Monotonic seconds.

    Raises
    ------
    StorageError
        If what is kept of the rig cannot be read.
    RecordingError
        If it is of another version.
    """

    def __init__(
        self,
        store: Store,
        broker: Broker,
        plan: Plan,
        epoch: int,
        stream: str,
        identity: str,
        patience: float,
        clock: Callable[[], float],
    ) -> None:
        self.plan = plan
        self.epoch = epoch
        self._store = store
        self._clock = clock
        self._identity = identity
        self._joined = _Joined()
        self._sink = StoreSink(self._joined)
        self._refused = False
        self.monitor: Monitor | None = None
        self.live_until: tuple[int, float] | None = None  # up to when the rig was heard, and when that was known
        self.heard_at: int | None = None
        name = plan.rig.name
        with store.read() as connection:
            kept = fleet.saved(connection, name)
        self._position = kept.position
        self._sums = kept.sums.known  # what the store has of them
        if kept.opening is not None and kept.checkpoint is not None:
            self._resume(kept)
        same = kept.position.stream == identity
        self.reader = LetterReader(
            broker,
            subject(stream, "digests", name),
            subject(stream, "wanted", name),
            kept.position.place,
            kept.position.sequence if same else 0,
            patience,
        )

    def _resume(self, kept: fleet.Saved) -> None:
        assert kept.opening is not None
        assert kept.checkpoint is not None
        run = self.plan.applied(codec.decode_opening(kept.opening).run)
        checkpoint = codec.unpacked(Checkpoint, kept.checkpoint)
        memory = replace(checkpoint.memory, blocks=kept.sums.blocks[-self.plan.window :])
        self.monitor = Monitor.resumed(run, replace(checkpoint, memory=memory, whole=kept.sums.whole))
        self._sink.resume(run, self.monitor.counts)
        heard = memory.quality.heard
        if heard is not None:  # it may have been heard meanwhile: its silence counts from now
            self.live_until = heard, self._clock()

    @property
    def run(self) -> str | None:
        """Id of the run that is being told."""
        return None if self.monitor is None else self.monitor.run.id

    def step(self, now_ns: int) -> bool:
        """Take the next letter; False if there is none.

        Parameters
        ----------
        now_ns : int
            Wall clock.

        Raises
        ------
        BrokerError, StorageError, LostRigError
            The object is then of no more use.
        """
        letter = self.reader.read(self._clock())
        if letter is None:
            return False
        if not self._fits(letter):
            self.reader.taken(letter)
            return True
        before = self.monitor
        opening = before is None or letter.begun != self._begun
        if opening:
            memory = None if before is None else before.memory
            run = self.plan.applied(letter.run)
            run = run if memory is None else replace(run, before=codec.memory_bytes(memory))
            self.monitor = Monitor(run, memory)
        assert self.monitor is not None
        outcomes: list[Outcome] = []
        if self.reader.missed:
            text = f"digests between {self.reader.place} and {letter.place} never came"
            outcomes += self.monitor.take(Fault(FaultKind.LOST, self.monitor.time, text))
        outcomes += self._digested(letter)
        heard = bool(letter.digest.transient or letter.digest.steady)
        if heard:
            self.heard_at = now_ns
            self.live_until = (letter.digest.end, self._clock()) if letter.live else None
        if letter.end is not None:
            self.live_until = None
        self._commit(outcomes, letter, opening)
        self.reader.taken(letter)
        return True

    def _digested(self, letter: Letter) -> list[Outcome]:
        assert self.monitor is not None
        try:
            digest = summed(self.monitor.run, letter.digest)
        except RecordingError as error:
            damaged = Fault(FaultKind.DAMAGED, letter.digest.end, str(error), letter.digest.index)
            return [*self.monitor.take(damaged), *self.monitor.take_digest(replace(letter.digest, frames=()))]
        return self.monitor.take_digest(digest)

    def serve(self, asked: Sequence[Asked]) -> None:
        """Carry out what operators ask for; answer, changes and state come about together."""
        if self.monitor is None:
            return
        for each in asked:
            done = self.monitor.act(each.action)
            changes = () if each.told or isinstance(done, Conflict) else done
            self._commit(changes, None, False, (each, done if isinstance(done, Conflict) else None))

    def hear(self, begun: int, until: int, now_ns: int) -> None:
        """Take note that frames of the run begun then have come until a recorded time, ns since the Unix epoch."""
        if self.monitor is None or begun != self._begun or until < self.monitor.time:
            return
        self.live_until, self.heard_at = (until, self._clock()), now_ns
        self._keep_changes(self.monitor.hear(until))

    def stop(self, begun: int) -> None:
        """Take note that the worker of the run begun then hears nothing of the rig."""
        if self.monitor is not None and begun == self._begun and self.live_until is not None:
            self._keep_changes(self.monitor.stop())

    def pass_time(self) -> None:
        """Let recorded time go on while nothing comes, so that silence is noticed and delays end."""
        if self.monitor is not None and self.live_until is not None:
            until, since = self.live_until
            self._keep_changes(self.monitor.take(Clock(until + round((self._clock() - since) * 1e9))))

    @property
    def _begun(self) -> int | None:
        return None if self.reader.place is None else self.reader.place[0]

    def _fits(self, letter: Letter) -> bool:
        """Whether a letter is of the rig that the service file describes."""
        told = letter.run.rig
        if replace(told, grid=self.plan.rig.grid) == self.plan.rig:
            return True
        if not self._refused:
            self._refused = True
            _log.error("%s: its worker measures another rig than the service file says; left out", told.name)
        return False

    def _keep_changes(self, outcomes: Sequence[Outcome]) -> None:
        if outcomes:
            self._commit(outcomes, None, False)

    def _commit(
        self,
        outcomes: Sequence[Outcome],
        letter: Letter | None,
        opening: bool,
        answer: tuple[Asked, Conflict | None] | None = None,
    ) -> None:
        """Write all that follows from a letter, an action or the time in one transaction."""
        monitor = self.monitor
        assert monitor is not None
        run, name = monitor.run, self.plan.rig.name
        checkpoint = monitor.checkpoint
        complete = any(isinstance(outcome, Estimate) for outcome in outcomes)
        position = self._position
        if letter is not None:
            blocks = position.blocks + complete
            position = Position(letter.place, self._identity, self.reader.sequence, blocks)
        small = replace(checkpoint, memory=replace(checkpoint.memory, blocks=()), whole=None)
        state = codec.encode(codec.Opening(replace(run, before=b""))), codec.packed(small)
        known = replace(self._sums, whole=None) if opening else self._sums
        window, whole = checkpoint.memory.blocks, checkpoint.whole
        sums = kept_sums.changes(known, run.window, window, whole) if complete else None
        # Effects and position come about together: what a power failure takes back is read from the stream anew.
        # So the disk need not be waited for, except where somebody is told.
        durable = answer is not None or any(isinstance(outcome, AlarmChange) for outcome in outcomes)
        with self._store.write(durable) as connection, told_last(connection):
            fleet.keep(connection, name, self.epoch, position, *state)
            self._joined.connection = connection
            if opening:
                self._sink.open(run)
                kept_sums.forget_whole(connection, kept_sums.fleet_sums, name)
            if sums is not None:
                kept_sums.write(connection, kept_sums.fleet_sums, name, sums)
            for outcome in outcomes:
                self._sink.take(outcome)
            self._sink.count(monitor.counts, monitor.time, self.heard_at)
            if letter is not None and letter.end is not None:
                self._sink.close(replace(letter.end, counts=monitor.counts))
            elif letter is not None:
                self._sink.flush()
            if answer is not None:
                actions.answer(connection, *answer)
        self._position = position
        self._sums = known if sums is None else sums.after
