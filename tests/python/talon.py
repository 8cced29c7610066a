"""Frames of the Talon SRX, written from docs/talon-srx.md and nothing else.

Signals of control and status frames have their high byte first, parameter values their low
byte first.
"""

import struct
from typing import NamedTuple

from dmc60c import Frame

# Message identifiers (29 bit). The low six bits carry the device number.
CONTROL_1 = 0x02040000
CONTROL_2 = 0x02040040
CONTROL_3 = 0x02040080
GLOBAL_ENABLE = 0x000401BF
DISABLE_ALL = 0x00000000
STATUS_1 = 0x02041400
STATUS_2 = 0x02041440
STATUS_3 = 0x02041480
STATUS_4 = 0x020414C0
PARAM_REQUEST = 0x02041800
PARAM_RESPONSE = 0x02041840
PARAM_SET = 0x02041880
ENUM_RESPONSE = 0x0204F000
VENDOR_COMMAND = 0x0204FC00
VENDOR_STATUS = 0x0204FCC0

DUTY, POSITION, VELOCITY, FOLLOWER, NO_DRIVE = 0, 1, 2, 5, 15
FULL = 1023
SLOT_0_P, SENSOR_POSITION = 1, 73


def control(number: int, mode: int, demand=0, ramp=0, limits=1, slot=0) -> Frame:
    """Control_1: everything a robot says to a motor controller."""
    data = bytes([0, 0]) + (demand & 0xFFFFFF).to_bytes(3, "big")
    data += bytes([slot | limits << 5, mode << 4, ramp])
    return Frame(CONTROL_1 | number, data)


def status_periods(number: int, general: int, feedback: int, encoder: int, analog: int) -> Frame:
    return Frame(CONTROL_2 | number, bytes([general, feedback, encoder, analog]))


def param_request(number: int, parameter: int) -> Frame:
    return Frame(PARAM_REQUEST | number, bytes([parameter]))


def param_set(number: int, parameter: int, value: int) -> Frame:
    return Frame(PARAM_SET | number, struct.pack("<BI", parameter, value & 0xFFFFFFFF))


def vendor_command(number: int, session: int, command: int, parameter=0) -> Frame:
    return Frame(VENDOR_COMMAND | number, struct.pack("<HHHH", session, command, parameter, 0))


class General(NamedTuple):
    """Status_1."""

    error: int
    throttle: int
    enabled: bool
    forward_closed: bool
    reverse_closed: bool
    forward_fault: bool
    mode: int


def general(data: bytes) -> General:
    throttle = (data[3] & 7) << 8 | data[4]
    return General(
        error=int.from_bytes(data[:3], "big", signed=True),
        throttle=throttle - 0x800 if throttle & 0x400 else throttle,
        enabled=bool(data[3] & 0x20),
        # 0 is closed.
        reverse_closed=not data[3] & 0x40,
        forward_closed=not data[3] & 0x80,
        forward_fault=bool(data[6] & 0x04),
        mode=(data[5] & 1) << 3 | data[6] >> 5,
    )


def position(data: bytes) -> int:
    """The selected sensor's position of Status_2."""
    return int.from_bytes(data[:3], "big", signed=True)
