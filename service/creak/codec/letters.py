"""Digests on their way: what a message says on the outside, what is in it, and its parts.

A letter stands at a place, ``(begun, index)``: when the run was begun, by the clock of the rig's worker, and the
index of the digest in it. Places of a rig rise; each letter names the place before it, so whoever has taken that
one misses nothing.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from creak.codec.memory import packed, unpacked
from creak.codec.protobuf import Opening, decode, decode_opening, encode
from creak.digests import CLOSING, OPENING, Digest
from creak.errors import RecordingError
from creak.records import Run, RunEnd

Place = tuple[int, int]

MESSAGE_ID = "Nats-Msg-Id"
_PLACE, _PREVIOUS, _PART, _LIVE = "Creak-Place", "Creak-Previous", "Creak-Part", "Creak-Live"


@dataclass(frozen=True, eq=False)
class Letter:
    """A digest with the run that it is of.

    Parameters
    ----------
    begun : int
        When the run was begun, ns since the Unix epoch; rises from run to run of a rig.
    before : tuple of int, or None
        Place of the last letter of the run before, or None if there is none.
    run : Run
    digest : Digest
    end : RunEnd or None
        How the run ended, in its last letter.
    live : bool
        True if the rig goes on in real time, so that nothing heard of it means silence.
    """

    begun: int
    before: Place | None
    run: Run
    digest: Digest
    end: RunEnd | None = None
    live: bool = True

    @property
    def place(self) -> Place:
        """Where it stands among the letters of its rig."""
        return self.begun, self.digest.index

    @property
    def previous(self) -> Place | None:
        """Place of the letter before it."""
        return self.before if self.digest.index == OPENING else (self.begun, self.digest.previous)


@dataclass(frozen=True)
class Envelope:
    """What is known of a message without opening it."""

    place: Place
    previous: Place | None
    part: int
    parts: int
    live: bool


def closing_place(begun: int) -> Place:
    """Place of the last letter of a run."""
    return begun, CLOSING


def letter_parts(letter: Letter, largest: int, again: str = "") -> Iterator[tuple[dict[str, str], bytes]]:
    """Yield the messages of a letter, headers and payload of at most `largest` bytes each.

    The same letter makes the same messages, whoever makes them and when, so the broker keeps them once; unless
    they are wanted `again`, for then it may only seem to have them.
    """
    data = _payload(letter)
    count = max(1, -(-len(data) // largest))
    begun, index = letter.place
    for part in range(count):
        headers = {
            MESSAGE_ID: f"{letter.run.rig.name.encode().hex()}/{begun}/{index}/{part}{again}",
            _PLACE: f"{begun} {index}",
            _PREVIOUS: "" if letter.previous is None else f"{letter.previous[0]} {letter.previous[1]}",
            _PART: f"{part} {count}",
            _LIVE: str(int(letter.live)),
        }
        yield headers, data[part * largest : (part + 1) * largest]


def envelope_of(headers: Mapping[str, str]) -> Envelope:
    """Read the outside of a message.

    Raises
    ------
    RecordingError
        If it is no letter of this program's.
    """
    try:
        place, part = _pair(headers[_PLACE]), _pair(headers[_PART])
        previous = _pair(headers[_PREVIOUS]) if headers.get(_PREVIOUS) else None
        return Envelope(place, previous, *part, headers.get(_LIVE) == "1")
    except (KeyError, ValueError) as error:
        raise RecordingError(f"a message whose headers cannot be understood: {error!r}") from None


def letter_of(envelope: Envelope, data: bytes) -> Letter:
    """Read a letter from the parts of it put together.

    Raises
    ------
    RecordingError
        If they are none of this version's.
    """
    sections: list[bytes] = []
    rest = memoryview(data)
    for _ in range(2):
        length = int.from_bytes(rest[:8], "little")
        sections.append(bytes(rest[8 : 8 + length]))
        rest = rest[8 + length :]
    end = decode("RunEnd", sections[1]) if sections[1] else None
    digest = unpacked(Digest, bytes(rest))
    if not (end is None or isinstance(end, RunEnd)) or digest.index != envelope.place[1]:
        raise RecordingError(f"a message that says it is {envelope.place}, and holds digest {digest.index}")
    before = envelope.previous if digest.index == OPENING else None
    run = decode_opening(sections[0]).run
    return Letter(envelope.place[0], before, run, digest, end, envelope.live)


def _payload(letter: Letter) -> bytes:
    sections = encode(Opening(letter.run)), b"" if letter.end is None else encode(letter.end)
    framed = (len(section).to_bytes(8, "little") + section for section in sections)
    return b"".join((*framed, packed(letter.digest)))


def _pair(text: str) -> tuple[int, int]:
    first, second = text.split()
    return int(first), int(second)
