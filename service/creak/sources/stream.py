"""Letters of one rig read from the stream: in order, each once, gaps asked for again.

A companion to whoever keeps the results: it says which letter comes next and up to which sequence nothing has to
be read again, and is told when that letter's effects are kept. Copies are passed over; behind a gap it looks for
the missing letter further on, and goes back once it has it.
"""

import json
from dataclasses import dataclass, field

from creak.broker import Broker
from creak.codec.letters import Envelope, Letter, Place, envelope_of, letter_of
from creak.errors import RecordingError

_ASK_SECONDS = 5.0
_OPEN_LETTERS = 4  # of which parts are kept


@dataclass
class _Gap:
    """The sequence before the first letter behind a gap, and when the gap was found and asked for."""

    resume: int
    found: float
    asked: float = float("-inf")


@dataclass
class _Parts:
    envelope: Envelope
    data: dict[int, bytes] = field(default_factory=dict)


class LetterReader:
    """Reads the letters of one rig.

    Parameters
    ----------
    broker : Broker
    digests, wanted : str
        Subjects of the rig: where its letters are kept, and where missing ones are asked for.
    place : tuple of int, or None
        Of the last letter that was taken; None takes whatever comes first.
    sequence : int
        Up to which nothing has to be read again.
    patience : float
        Seconds after which a gap is given up.

    Attributes
    ----------
    sequence : int
        Up to which nothing has to be read again, once the letter that `read` gave is taken.
    missed : bool
        There is a gap before the letter that `read` gave, which was waited for in vain.
    damaged : int
        Messages that could not be read.
    """

    def __init__(
        self, broker: Broker, digests: str, wanted: str, place: Place | None, sequence: int, patience: float
    ) -> None:
        self.place = place
        self.sequence = self._at = sequence
        self.missed = False
        self.damaged = 0
        self._broker = broker
        self._digests = digests
        self._wanted = wanted
        self._patience = patience
        self._gap: _Gap | None = None
        self._give_up = False
        self._open: dict[Place, _Parts] = {}

    @property
    def waiting(self) -> bool:
        """True while a gap is to be filled."""
        return self._gap is not None

    def read(self, now: float) -> Letter | None:
        """Return the next letter; None if there is none yet.

        Parameters
        ----------
        now : float
            Monotonic time, s.

        Raises
        ------
        BrokerError
        """
        while True:
            message = self._broker.next(self._digests, self._at)
            if message is None:
                if self._gives_up(now):
                    continue
                return None
            before, self._at = self._at, message.sequence
            try:
                envelope = envelope_of(message.headers)
                known = self.place is not None and envelope.place <= self.place
                if not known and not self._follows(envelope):
                    if self._gap is None:
                        self._gap = _Gap(before, now)
                    self._gives_up(now)
                    continue
                letter = None if known else self._whole(envelope, message.data)
            except RecordingError:
                self.damaged += 1
                continue
            if letter is not None:
                self.missed = not self._linked(envelope)
                if self._gap is None and not self._open:
                    self.sequence = self._at
                return letter
            if known and self._gap is None and not self._open:
                self.sequence = self._at

    def taken(self, letter: Letter) -> None:
        """Take note that a letter's effects are kept; if it was missing, reading goes on where it was missed."""
        self.place = letter.place
        self._give_up = False
        if self._gap is not None:
            self._at, self._gap = self._gap.resume, None
            self._open.clear()

    def look_again(self, sequence: int = 0) -> None:
        """Read from an earlier sequence on: the stream is another, or has lost its end."""
        if sequence < self._at:
            self.sequence = min(self.sequence, sequence)
            self._at, self._gap = sequence, None
            self._open.clear()

    def _linked(self, envelope: Envelope) -> bool:
        return self.place is None or envelope.previous is None or envelope.previous <= self.place

    def _follows(self, envelope: Envelope) -> bool:
        return self._give_up or self._linked(envelope)

    def _gives_up(self, now: float) -> bool:
        """Ask for what is missing; if that has been in vain for long enough, go back to where reading stopped."""
        gap = self._gap
        if gap is None or self.place is None:
            return False
        if now - gap.found >= self._patience:
            self._at, self._gap, self._give_up = gap.resume, None, True
            self._open.clear()
            return True
        if now - gap.asked >= _ASK_SECONDS:
            gap.asked = now
            self._broker.tell(self._wanted, json.dumps({"after": self.place}).encode())
        return False

    def _whole(self, envelope: Envelope, data: bytes) -> Letter | None:
        """Put the parts of a letter together; None until they are all there."""
        parts = self._open.setdefault(envelope.place, _Parts(envelope))
        parts.data[envelope.part] = data
        if len(parts.data) < envelope.parts:
            while len(self._open) > _OPEN_LETTERS:
                del self._open[min(self._open)]
            return None
        del self._open[envelope.place]
        return letter_of(envelope, b"".join(parts.data[part] for part in sorted(parts.data)))
