"""DBC files and mappings of small rigs for the CAN tests."""

from creak.config.can import CanSource
from creak.sources.can_mapping import map_signals
from creak.sources.dbc import Database

HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: C X\n\n'


def message(identifier, name, size, signals):
    return f"BO_ {identifier} {name}: {size} C\n" + "".join(f" SG_ {s}\n" for s in signals) + "\n"


def one_frame(n, samples=4, counter_bits=32, crc=32, scales=("0.001", "0.0005")):
    """Everything in one CAN FD frame, several samples in it: the layout of the beam's DBC."""
    bit = 0
    signals = []
    for name, length in (("Counter", counter_bits), ("Realisation", 8), ("Experiment", 4), ("Period", 4)):
        signals.append(f'{name} : {bit}|{length}@1+ (1,0) [0|0] "" X')
        bit += length
    for s in range(samples):
        for node in range(1, n + 1):
            for letter, scale in zip("UY", scales, strict=True):
                signals.append(f'{letter}_{node}_{s} : {bit}|16@1- ({scale},0) [0|0] "" X')
                bit += 16
    signals.append(f'Valid : {bit}|8@1+ (1,0) [0|0] "" X')
    bit += 8
    if crc:
        signals.append(f'Crc : {bit}|{crc}@1+ (1,0) [0|0] "" X')
        bit += crc
    assert bit <= 512
    return HEAD + message(256, "Samples", next(s for s in (16, 20, 24, 32, 48, 64) if 8 * s >= bit), signals)


def two_messages(n):
    """Inputs a sample a frame, little endian; responses two in a frame, big endian, float, another counter."""
    drive = ['Counter : 0|16@1+ (1,0) [0|0] "" X', 'Realisation : 16|8@1+ (1,0) [0|0] "" X',
             'Experiment : 24|4@1+ (1,0) [0|0] "" X', 'Period : 28|4@1+ (1,0) [0|0] "" X']  # fmt: skip
    drive += [f'U_{k} : {32 + 16 * (k - 1)}|16@1- (0.001,0) [0|0] "" X' for k in range(1, n + 1)]
    motion = ['Counter : 7|16@0+ (1,0) [0|0] "" X']
    byte = 2
    kinds = []
    for s in range(2):
        for k in range(1, n + 1):
            motion.append(f'Y_{k}_{s} : {8 * byte + 7}|32@0- (1,0) [0|0] "" X')
            kinds.append(f"SIG_VALTYPE_ 513 Y_{k}_{s} : 1;")
            byte += 4
    size = next(s for s in (12, 16, 20, 24, 32) if s >= byte)
    return HEAD + message(512, "Drive", 8, drive) + message(513, "Motion", size, motion) + "\n".join(kinds) + "\n"


def with_sync(n):
    """A SYNC message counts and marks; inputs and responses follow it without a counter, classic CAN."""
    sync = ['Counter : 0|16@1+ (1,0) [0|0] "" X', 'Realisation : 16|8@1+ (1,0) [0|0] "" X',
            'Experiment : 24|4@1+ (1,0) [0|0] "" X', 'Period : 28|4@1+ (1,0) [0|0] "" X']  # fmt: skip
    drive = [f'U_{k} : {16 * (k - 1)}|16@1- (0.001,0) [0|0] "" X' for k in range(1, n + 1)]
    motion = [f'Y_{k} : {16 * (k - 1) + 7}|16@0- (0.0005,0) [0|0] "" X' for k in range(1, n + 1)]
    extended = (1 << 31) + 512
    both = message(extended, "Drive", 8, drive) + message(513, "Motion", 8, motion)
    return HEAD + message(128, "Sync", 8, sync) + both


def multiplexed(n):
    """Inputs and responses in turn under one identifier."""
    signals = ['Which M : 0|2@1+ (1,0) [0|0] "" X', 'Counter : 2|22@1+ (1,0) [0|0] "" X',
               'Realisation : 24|8@1+ (1,0) [0|0] "" X', 'Experiment : 32|4@1+ (1,0) [0|0] "" X',
               'Period : 36|4@1+ (1,0) [0|0] "" X']  # fmt: skip
    signals += [f'U_{k} m1 : {40 + 12 * (k - 1)}|12@1- (0.005,0) [0|0] "" X' for k in range(1, n + 1)]
    signals += [f'Y_{k} m2 : {40 + 12 * (k - 1)}|12@1- (0.005,0) [0|0] "" X' for k in range(1, n + 1)]
    return HEAD + message(300, "Both", 8, signals)


SYNC = {"counters": {name: {"signal": "Sync.Counter"} for name in ("Drive", "Motion")},
        "realisation": "Sync.Realisation", "experiment": "Sync.Experiment", "period": "Sync.Period"}  # fmt: skip
LAYOUTS = {
    "one frame": (one_frame, {}),
    "two messages": (two_messages, {}),
    "sync": (with_sync, SYNC),
    "multiplexed": (multiplexed, {}),
}


def source(tmp_path, text, signals=None, **keys):
    path = tmp_path / "rig.dbc"
    path.write_text(text)
    keys = {"interface": "virtual", "channel": "x", "fd": True, **keys}
    return CanSource(kind="can", dbc=path, signals=signals or {}, **keys)


def mapping(tmp_path, run, text, signals=None, **keys):
    given = source(tmp_path, text, signals, **keys)
    return map_signals(Database(given.dbc), given, run, "creak.toml", "rigs[0].source")
