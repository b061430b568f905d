"""The sink that tells a rig's realisations to the fleet: in order, once each, and for as long as it takes.

The recording is the queue: a few letters wait in memory, and when the broker has been away for longer, or a reader
asks for what it has missed, they are made again from the recording. So memory has an end and nothing is lost.
"""

import json
import logging
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

from creak.broker import Broker
from creak.codec.letters import Letter, Place, closing_place, letter_parts
from creak.digests import CLOSING, OPENING, Digest, Outcome
from creak.errors import BrokerError, CreakError
from creak.records import Fault, FaultKind, Frame, FrameStatus, Run, RunEnd
from creak.sinks.journal import Journal, RecordedRun
from creak.sinks.recorder import recording_name

_log = logging.getLogger(__name__)

Retold = Callable[..., Iterator[tuple[Run, Digest, RunEnd | None]]]

_WAITING = 16  # letters in memory
_HEADERS_BYTES = 4096  # room for them in a message
_NEWS_SECONDS = 2.0
_RETRY_SECONDS = 1.0
_CLOSE_SECONDS = 2.0
_ASKED_SECONDS = 30.0  # the same is not told again sooner: it may be on its way
_STOPPING = {FaultKind.SILENT, FaultKind.BUS_OFF, FaultKind.DISCONNECTED}
_NOTHING: Place = (-1, OPENING)


def subject(stream: str, kind: str, rig: str) -> str:
    """Subject of a rig: ``digests`` that are kept, ``news`` of them, and what is ``wanted`` again."""
    token = "".join(c if re.match("[A-Za-z0-9_-]", c) else "".join(f"={b:02X}" for b in c.encode()) for c in rig)
    return f"{stream}.{kind}.{token}"


class StreamSink:
    """Publishes the digests of one rig, run after run.

    Parameters
    ----------
    broker : Broker
    stream : str
        Name of the stream.
    folder : Path
        Where the recordings of the rig lie, and the journal of what was sent.
    retold : callable
        Makes digests again from a recording (:func:`creak.sources.retold.retold`).
    whole_frames : bool
        As the digests of the run are.
    live : bool
        False if the source may be held back, so that silence means nothing.
    """

    def __init__(
        self,
        broker: Broker,
        stream: str,
        folder: Path,
        retold: Retold,
        *,
        whole_frames: bool = False,
        live: bool = True,
    ) -> None:
        self._broker = broker
        self._stream = stream
        self._folder = folder
        self._retold = retold
        self._whole_frames = whole_frames
        self._live = live
        self._news = threading.Condition()  # guards all below
        self._waiting: deque[Letter] = deque(maxlen=_WAITING)
        self._sent = self._highest = _NOTHING  # `sent` goes back when something is wanted again
        self._asked: tuple[Place, float] = (_NOTHING, float("-inf"))
        self._again = ""
        self._behind = True  # something before the letters in memory may have to be told
        self._heard: int | None = None
        self._stopped = False
        self._ending = False
        self._finished: Digest | None = None
        self._past: Iterator[Letter] | None = None
        self._past_at = _NOTHING  # place from which it goes on
        self._thread: threading.Thread | None = None

    def open(self, run: Run) -> None:
        """Begin a run; what an earlier one has left unsent goes first.

        Raises
        ------
        StorageError
            If the journal of what was sent cannot be read or written.
        """
        self._run = run
        self._journal = Journal(self._folder / f"{recording_name(run.rig.name, run.rig.name)}.sent.json")
        earlier = self._journal.runs[-1] if self._journal.runs else None
        self._before = None if earlier is None else closing_place(earlier.begun)
        self._sent = self._highest = self._journal.sent or _NOTHING
        self._begun = self._journal.begin(recording_name(run.rig.name, run.id))
        self._put(Digest(OPENING, OPENING, run.start))
        self._thread = threading.Thread(target=self._publish, name=f"stream {run.rig.name}", daemon=True)
        self._thread.start()

    def take(self, record: Outcome) -> None:
        """Queue a digest, after the recorder has it; note of anything else that the rig is alive or not."""
        match record:
            case Digest(index=index) if index == CLOSING:
                self._finished = record
            case Digest():
                self._put(record)
            case Frame(status=status) if status is not FrameStatus.REJECTED:
                self._heard = record.time + round(self._run.rig.period_ns)
            case Fault(kind=kind) if kind in _STOPPING:
                self._stopped = True

    def tick(self, now: float) -> None:
        """Do nothing: the thread of the sink has a clock of its own."""

    def close(self, end: RunEnd) -> None:
        """Tell how the run ended; what the broker does not take within moments is told by the next worker."""
        self._put(self._finished or Digest(CLOSING, CLOSING, end.time), end)
        with self._news:
            self._ending = True
            self._news.notify()
        if self._thread is not None:
            self._thread.join(_CLOSE_SECONDS)
        self._broker.ignore(subject(self._stream, "wanted", self._run.rig.name))

    @property
    def sent(self) -> Place:
        """Place of the last letter that the broker has."""
        return self._sent

    @property
    def waiting(self) -> int:
        """Letters in memory that the broker does not have; older ones are in the recording alone."""
        return len(self._waiting)

    def _put(self, digest: Digest, end: RunEnd | None = None) -> None:
        letter = Letter(self._begun, self._before, self._run, digest, end, self._live)
        with self._news:
            self._waiting.append(letter)
            self._news.notify()

    def _publish(self) -> None:
        """Send letter after letter; runs in the thread of the sink."""
        generation, told = 0, float("-inf")
        while True:
            try:
                if self._broker.connected and self._broker.generation != generation:
                    self._broker.listen(subject(self._stream, "wanted", self._run.rig.name), self._wanted)
                    generation = self._broker.generation
                if time.monotonic() - told >= _NEWS_SECONDS:
                    told = time.monotonic()
                    self._tell_news()
                letter = self._following()
                if letter is not None:
                    self._send(letter)
                    continue
                with self._news:
                    if not self._waiting and not self._behind:
                        if self._ending:
                            return
                        self._news.wait(_NEWS_SECONDS / 4)
            except (CreakError, OSError) as error:
                if not isinstance(error, BrokerError):
                    _log.error("%s: %s", self._run.rig.name, error)
                if self._ending:
                    return
                time.sleep(_RETRY_SECONDS)

    def _following(self) -> Letter | None:
        """The letter that follows what was sent, from memory or made again; None if there is none yet."""
        letter = self._ready()
        if letter is not None or not self._behind:
            return letter
        at = self._sent
        for _ in range(2):  # if one pass is at its end, more may have been recorded since it began
            if self._past is None or self._past_at != at:
                self._past = self._tell_again(at)
            letter = next(self._past, None)
            if letter is not None:
                self._past_at = letter.place
                return letter
            self._past = None
        with self._news:
            self._behind = self._sent != at
        return self._ready(gap=True)  # nothing on disk leads up to it: whoever reads it sees the gap

    def _ready(self, gap: bool = False) -> Letter | None:
        """The first letter in memory, if it is the one that follows what was sent."""
        with self._news:
            while self._waiting and self._waiting[0].place <= self._sent:
                self._waiting.popleft()
            if not self._waiting:
                return None
            letter = self._waiting[0]
            if gap or letter.previous is None or letter.previous <= self._sent:
                self._behind = False
                return letter
            self._behind = True
            return None

    def _send(self, letter: Letter) -> None:
        at = self._sent
        room = self._broker.largest - _HEADERS_BYTES
        rig = letter.run.rig.name
        sequences = [
            self._broker.publish(subject(self._stream, "digests", rig), data, headers)
            for headers, data in letter_parts(letter, room, self._again if letter.place <= self._highest else "")
        ]
        with self._news:
            expected = self._sent == at  # else somebody has asked for earlier ones meanwhile
            if expected:
                self._sent = letter.place
                self._highest = max(self._highest, letter.place)
        if expected:  # not above: the disk holds up nobody who has news
            self._journal.note(letter.place)
        self._tell_news(letter.place, sequences[0])

    def _tell_news(self, place: Place | None = None, sequence: int = 0) -> None:
        """Say what is new, and up to when the rig was heard; whoever misses it finds out later."""
        heard, stopped, self._stopped = self._heard, self._stopped, False
        if not self._broker.connected or (place is None and heard is None and not stopped):
            return
        if place is None:
            self._heard = None
        news = {
            "place": place,
            "sequence": sequence,
            "begun": self._begun,
            "heard": heard if self._live else None,
            "stopped": stopped,
        }
        self._broker.tell(subject(self._stream, "news", self._run.rig.name), json.dumps(news).encode())

    def _wanted(self, data: bytes) -> None:
        """Go back to where a reader has a gap; in the broker's thread."""
        try:
            begun, index = json.loads(data)["after"]
            after = int(begun), int(index)
        except (ValueError, KeyError, TypeError):
            return
        now = time.monotonic()
        with self._news:
            place, asked = self._asked
            if after < self._sent and (place != after or now - asked >= _ASKED_SECONDS):
                self._asked, self._again = (after, now), f"/{time.time_ns()}"
                _log.info("%s: told again from %s on, as asked for", self._run.rig.name, after)
                self._sent, self._behind = after, True
                self._news.notify()

    def _tell_again(self, after: Place) -> Iterator[Letter]:
        """Make the letters that follow a place again, as far as their recordings are there."""
        before: RecordedRun | None = None
        for run in list(self._journal.runs):
            previous, before = before, run
            if closing_place(run.begun) <= after:
                continue
            paths = self._journal.parts(run)
            if not paths:
                continue
            index = after[1] if after[0] == run.begun else OPENING - 1
            told = self._retold(paths, index, whole_frames=self._whole_frames, ended=run.begun != self._begun)
            place = None if previous is None else closing_place(previous.begun)
            try:
                for opening, digest, end in told:
                    yield Letter(run.begun, place, opening, digest, end, self._live)
            except (CreakError, OSError) as error:
                _log.warning("%s: %s; what is in it cannot be told again", self._run.rig.name, error)
