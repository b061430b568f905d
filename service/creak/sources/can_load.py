"""Whether a rig's frames fit the bus: length of a frame on the wire with the most stuff bits that there can be.

Bit counts of ISO 11898-1:2015; stuffing by R. I. Davis et al., *Real-Time Systems* 35 (2007) 239.
"""

_DATA_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


def padded(length: int) -> int:
    """Return the shortest payload that CAN FD has for so many bytes."""
    return next(possible for possible in _DATA_LENGTHS if possible >= length)


def frame_seconds(
    length: int, *, extended: bool, fd: bool, bitrate: float, data_bitrate: float, stuffed: bool = True
) -> float:
    """Longest time that one frame takes on the bus, the space after it included.

    Parameters
    ----------
    length : int
        Payload, bytes.
    extended : bool
        Identifier of 29 bits.
    fd : bool
        CAN FD with bit rate switch.
    bitrate, data_bitrate : float
        Bits a second of arbitration and data phase; the latter counts for CAN FD only.
    stuffed : bool
        False for the shortest time instead: a frame without stuff bits, but for those of the CRC.
    """
    if not fd:
        stuffable = (54 if extended else 34) + 8 * length
        return (stuffable + ((stuffable - 1) // 4 if stuffed else 0) + 13) / bitrate
    payload = padded(length)
    # SOF, identifier, RRS or SRR and IDE, FDF, res, BRS with stuff bits; CRC delimiter, ACK, EOF, intermission.
    arbitration = 36 if extended else 17
    slow = arbitration + ((arbitration - 1) // 4 if stuffed else 0) + 1 + 2 + 7 + 3
    # ESI, DLC and payload are stuffed as they come; stuff count and CRC have a fixed stuff bit every fourth bit.
    stuffable = 5 + 8 * payload
    crc = 21 if payload > 16 else 17
    fast = stuffable + (stuffable // 4 if stuffed else 0) + 4 + crc + (4 + crc + 3) // 4
    return slow / bitrate + fast / data_bitrate
