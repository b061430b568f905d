"""Which signals of a DBC are what: resolved, checked against rig and bus, and each slip one line."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from creak.config.can import CanSource, CounterTable, SignalsTable
from creak.counters import Counting
from creak.errors import ConfigurationError
from creak.records import Rig, Run
from creak.sources.can_load import frame_seconds
from creak.sources.dbc import Condition, Database, Message, Payload, Signal

_MOST_COUNTS = 1 << 60  # samples that are told apart: what is more never comes round, and sums stay in 64 bits
_MOST_REALISATIONS = 1 << 31  # likewise


@dataclass(frozen=True)
class CountedBy:
    """The counter that places the samples of a message.

    Parameters
    ----------
    message : Message
        Where it lies: the message itself, or the SYNC message that goes before it.
    signal : Signal
    factor : int
        Samples a count.
    wraps : int
        Samples after which it is 0 again.
    offset : int
        Count of the run's sample 0.
    """

    message: Message
    signal: Signal
    factor: int
    wraps: int
    offset: int

    def samples(self, data: Payload) -> NDArray[np.int64]:
        """Samples counted in payloads ``(frames, bytes)`` of the message, from 0 to the wrap, ``(frames,)``."""
        counts: NDArray[np.int64] = (
            self.signal.raw(data).astype(np.int64) % (self.wraps // self.factor) * self.factor
        )
        return counts


@dataclass(frozen=True)
class MappedPart:
    """Channels that come together in a message.

    Parameters
    ----------
    message : Message
    channels : tuple of int
        Inputs 0 to q - 1, then responses; empty for a message that only counts and marks.
    signals : tuple of tuple of Signal
        For every channel its consecutive samples.
    samples : int
        Consecutive samples in a frame.
    conditions : tuple of Condition
        When a frame carries them.
    counted_by : CountedBy
    valid : tuple of Signal
        Samples are used only where none of these is 0.
    """

    message: Message
    channels: tuple[int, ...]
    signals: tuple[tuple[Signal, ...], ...]
    samples: int
    conditions: tuple[Condition, ...]
    counted_by: CountedBy
    valid: tuple[Signal, ...]


@dataclass(frozen=True)
class CanMapping:
    """All that is needed to turn frames into samples.

    Parameters
    ----------
    parts : tuple of MappedPart
    leading : int
        The part whose counter and markers lead.
    markers : tuple of Signal
        Of the leading message: realisation, experiment, period, as far as they are given.
    counting : Counting
    checksums : mapping of str to Signal
        By message.
    """

    parts: tuple[MappedPart, ...]
    leading: int
    markers: tuple[Signal, ...]
    counting: Counting
    checksums: Mapping[str, Signal]


def map_signals(database: Database, source: CanSource, run: Run, file: str, key: str) -> CanMapping:
    """Resolve and check the signals of a CAN source.

    Parameters
    ----------
    database : Database
    source : CanSource
    run : Run
    file, key : str
        Where the source stands, for messages: ``creak.toml``, ``rigs[0].source``.

    Raises
    ------
    ConfigurationError
        One line: a signal that the DBC lacks, a node without one, no excitation, a counter that is too short,
        a rate that the bus cannot carry.
    """
    return _Resolver(database, source.signals, run, file, f"{key}.signals" if key else "").mapping(source, key)


class _Resolver:
    def __init__(self, database: Database, table: SignalsTable, run: Run, file: str, key: str) -> None:
        self._database = database
        self._run = run
        self._rig: Rig = run.rig
        self._file, self._key = file, key
        self._table = table

    def mapping(self, source: CanSource, key: str) -> CanMapping:
        groups = self._grouped(list(self._channels()))
        checksums = self._checksums()
        valid = [self._find(name, "valid") for name in self._table.valid]
        markers = [self._find(name, "markers") for name in self._table.markers] or self._markers_by_name(groups)
        if len({message.name for message, _ in markers}) > 1:
            names = ", ".join(signal.name for _, signal in markers)
            raise self._wrong("realisation", f"{names} lie in several messages; markers come in one")
        parts = [
            MappedPart(
                message,
                tuple(channel for channel, _ in channels),
                tuple(signals for _, signals in channels),
                len(channels[0][1]),
                conditions,
                self._counted_by(message, len(channels[0][1])),
                tuple(signal for holder, signal in valid if holder.name == message.name)
                or tuple(s for name, s in message.signals.items() if name.lower() == "valid"),
            )
            for (message, conditions), channels in groups
        ]
        leading = self._leading(parts, markers)
        counted = parts[leading].counted_by
        ranges = tuple(min(signal.range, _MOST_REALISATIONS) for _, signal in markers)
        counting = Counting(counted.wraps, ranges)
        problem = counting.problem(self._run)
        if problem:
            raise self._wrong("counter", f"{counted.signal.name} {problem}")
        for part in parts:
            other = part.counted_by
            if other.wraps < self._rig.period_samples:
                raise self._wrong(
                    "counters",
                    f"{other.signal.name} wraps after {other.wraps} samples, before a period of "
                    f"{self._rig.period_samples} ends: too short",
                )
            if counted.wraps % other.wraps and not counting.endless(self._run):
                raise self._wrong(
                    "counters",
                    f"{other.signal.name} wraps after {other.wraps} samples, which is no divisor of the "
                    f"{counted.wraps} of {counted.signal.name}, so the two cannot be held together",
                )
        self._check_load(parts, source, key)
        return CanMapping(tuple(parts), leading, tuple(signal for _, signal in markers), counting, checksums)

    def _wrong(self, key: str, problem: str) -> ConfigurationError:
        return ConfigurationError(self._file, self._path(key), problem)

    def _path(self, key: str) -> str:
        return f"{self._key}.{key}" if self._key else key

    def _find(self, name: str, key: str) -> tuple[Message, Signal]:
        return self._database.signal(name, self._path(key), self._file)

    def _channels(self) -> Iterator[tuple[int, Message, tuple[Signal, ...]]]:
        """Every channel with its message and its samples."""
        rig, driven = self._rig, [self._rig.nodes[i].name for i in self._rig.driven]
        every = [node.name for node in rig.nodes]
        for kind, table, nodes in (
            ("inputs", self._table.inputs, driven),
            ("responses", self._table.responses, every),
        ):
            unknown = [name for name in table if name not in nodes]
            if unknown:
                what = "driven node" if kind == "inputs" and unknown[0] in every else "node"
                raise self._wrong(kind, f"{unknown[0]!r} is no {what} of the rig {rig.name!r}")
        inputs = [self._samples("inputs", "u", self._table.inputs, name) for name in driven]
        if not any(inputs):
            raise ConfigurationError(
                str(self._database.path),
                "",
                "cannot be analysed: no signal is an input (none is named in 'signals.inputs' or called "
                f"u_{driven[0]}), and without a known excitation no response can be told from distortion",
            )
        found = inputs + [self._samples("responses", "y", self._table.responses, name) for name in every]
        for channel, signals in enumerate(found):
            if not signals:
                node = (driven + every)[channel]
                kind, letter = ("inputs", "u") if channel < rig.q else ("responses", "y")
                raise self._wrong(
                    kind,
                    f"no signal is given for node {node!r}, and none is called {letter}_{node}",
                )
            messages = {message.name for message, _ in signals}
            if len(messages) > 1:
                raise self._wrong(
                    "inputs", f"{signals[0][1].name} and {signals[-1][1].name}: one channel, two messages"
                )
            yield channel, signals[0][0], tuple(signal for _, signal in signals)

    def _samples(
        self, kind: str, letter: str, table: Mapping[str, str | list[str]], node: str
    ) -> list[tuple[Message, Signal]]:
        key = f"{kind}.{node}"
        given = table.get(node)
        if given is None:
            return self._by_name(letter, node)
        if isinstance(given, list):
            return [self._find(name, key) for name in given]
        if "{}" not in given:
            return [self._find(given, key)]
        found = [self._find(given.replace("{}", "0"), key)]
        while True:
            name = given.replace("{}", str(len(found))).rpartition(".")[2]
            message = found[0][0]
            if name not in message.signals:
                return found
            found.append((message, message.signals[name]))

    def _by_name(self, letter: str, node: str) -> list[tuple[Message, Signal]]:
        """Signals called ``u_<node>``, or ``u_<node>_0``, ``u_<node>_1`` ... in one frame."""
        safe = re.escape(re.sub(r"\W", "_", node))
        plain = re.compile(rf"{letter}_?{safe}", re.IGNORECASE)
        several = re.compile(rf"{letter}_?{safe}_(\d+)", re.IGNORECASE)
        for message in self._database.messages.values():
            for name, signal in message.signals.items():
                if plain.fullmatch(name):
                    return [(message, signal)]
            found = {int(m[1]): s for name, s in message.signals.items() if (m := several.fullmatch(name))}
            if found and sorted(found) == list(range(len(found))):
                return [(message, found[i]) for i in range(len(found))]
        return []

    def _grouped(
        self, channels: Sequence[tuple[int, Message, tuple[Signal, ...]]]
    ) -> list[tuple[tuple[Message, tuple[Condition, ...]], list[tuple[int, tuple[Signal, ...]]]]]:
        """Channels that come together: of one message and one multiplexer value."""
        groups: dict[
            tuple[str, tuple[Condition, ...]],
            tuple[tuple[Message, tuple[Condition, ...]], list[tuple[int, tuple[Signal, ...]]]],
        ] = {}
        used: dict[str, int] = {}
        for channel, message, signals in channels:
            for signal in signals:
                if signal.name in used:
                    raise self._wrong("responses", f"{signal.name} is named for two channels")
                used[signal.name] = channel
            conditions = signals[0].conditions
            group = groups.setdefault((message.name, conditions), ((message, conditions), []))
            if group[1] and len(group[1][0][1]) != len(signals):
                raise self._wrong(
                    "responses",
                    f"{signals[0].name} has {len(signals)} samples in a frame, "
                    f"{group[1][0][1][0].name} has {len(group[1][0][1])}; should be as many",
                )
            group[1].append((channel, signals))
        return list(groups.values())

    def _counted_by(self, message: Message, samples: int) -> CountedBy:
        table = self._table
        own = table.counters.get(message.name)
        if own is None:
            own = CounterTable(
                signal=table.counter or f"{message.name}.{self._counter_by_name(message)}",
                counts=table.counts,
                wraps=table.wraps,
            )
        holder, signal = self._find(own.signal, f"counters.{message.name}" if table.counters else "counter")
        if holder.name != message.name and not table.counters.get(message.name) and table.counter:
            nearby = self._counter_by_name(message, missing="")
            if nearby:
                holder, signal = message, message.signals[nearby]
        if signal.floating or signal.signed or signal.scale != 1 or signal.offset != 0:
            raise self._wrong("counter", f"{signal.name}: should be an unsigned whole number without scaling")
        factor = samples if own.counts == "frames" else 1
        values = own.wraps or signal.range
        if values > signal.range:
            raise self._wrong("wraps", f"{values} is not allowed: {signal.name} has {signal.range} values")
        while values * factor > _MOST_COUNTS:  # halves of a power of two: its wrap stays one of theirs
            values //= 2
        return CountedBy(holder, signal, factor, values * factor, own.offset)

    def _counter_by_name(self, message: Message, missing: str | None = None) -> str:
        for name in message.signals:
            if name.lower() in ("counter", "count", "sample"):
                return name
        if missing is not None:
            return missing
        raise self._wrong(
            "counter",
            f"message {message.name!r} has no signal called 'Counter' and none is named; "
            "samples are placed by their counter, not by their arrival",
        )

    def _markers_by_name(
        self, groups: Sequence[tuple[tuple[Message, object], object]]
    ) -> list[tuple[Message, Signal]]:
        for (message, _), _ in groups:
            names = {name.lower(): name for name in message.signals}
            found = []
            for marker in ("realisation", "experiment", "period"):
                if marker not in names:
                    break
                found.append((message, message.signals[names[marker]]))
            if found:
                return found
        return []

    def _checksums(self) -> dict[str, Signal]:
        found = [self._find(name, "checksum") for name in self._table.checksum]
        if not found:
            found = [
                (message, signal)
                for message in self._database.messages.values()
                for name, signal in message.signals.items()
                if name.lower() in ("crc", "checksum") and signal.length in (8, 16, 32)
            ]
        for _, signal in found:
            aligned = signal.start % 8 == (7 if signal.big_endian else 0)
            if signal.length not in (8, 16, 32) or not aligned:
                raise self._wrong("checksum", f"{signal.name}: should be 8, 16 or 32 bits that begin with a byte")
        return {message.name: signal for message, signal in found}

    def _leading(self, parts: list[MappedPart], markers: Sequence[tuple[Message, Signal]]) -> int:
        """Index of the part that leads; a message that only counts and marks becomes a part of its own."""
        holder = markers[0][0] if markers else None
        if holder is None:
            holder = max(parts, key=lambda part: part.counted_by.wraps).counted_by.message
        for index, part in enumerate(parts):
            if part.message.name == holder.name and part.counted_by.message.name == holder.name:
                return index
        parts.append(MappedPart(holder, (), (), 1, (), self._counted_by(holder, 1), ()))
        return len(parts) - 1

    def _check_load(self, parts: Sequence[MappedPart], source: CanSource, key: str) -> None:
        fd_needed = [part.message.name for part in parts if part.message.length > 8]
        if fd_needed and not source.fd and source.interface is not None:
            raise ConfigurationError(
                self._file,
                f"{key}.fd",
                f"is false, but message {fd_needed[0]!r} is longer than 8 bytes: needs CAN FD",
            )
        if source.bitrate is None:
            return
        data_bitrate = source.data_bitrate or source.bitrate
        load = sum(
            self._rig.sample_rate
            / part.samples
            * frame_seconds(
                part.message.length,
                extended=part.message.extended,
                fd=source.fd and part.message.fd,
                bitrate=source.bitrate,
                data_bitrate=data_bitrate,
            )
            for part in parts
            if part.channels
        )
        if load > 1:
            frames = sum(self._rig.sample_rate / part.samples for part in parts if part.channels)
            raise ConfigurationError(
                self._file,
                f"{key}.bitrate",
                f"{frames:.0f} frames a second need {load:.0%} of the bus at {source.bitrate} bit/s"
                + (f" and {data_bitrate} bit/s" if source.fd else "")
                + f": {load - 1:.0%} over; lower the sample rate, or send more samples in a frame",
            )
