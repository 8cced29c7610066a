"""Frames of the DMC60C CAN protocol, written from the protocol guide and nothing else.

Every builder returns a `Frame`; every reader takes the data bytes of a received frame.
Multi-byte fields are little-endian, except where noted: the encoder status is big-endian
and the target of the control frame is spread as H, L, M over bytes 3, 4 and 5.
"""

import struct
from typing import NamedTuple

# Message identifiers (29 bit). The low six bits carry the device number.
ENUM = 0x00000240
ENUM_RESPONSE = 0x0206F000
CONTROL_0 = 0x02060000
STATUS_GENERAL = 0x02061400
STATUS_ENCODER = 0x02061480
STATUS_ANALOG = 0x020614C0
PARAM_REQUEST = 0x02061800
PARAM_RESPONSE = 0x02061840
PARAM_SET = 0x02061880
VENDOR_COMMAND = 0x0206FC00
VENDOR_DATA_OUT = 0x0206FC40
VENDOR_DATA_IN = 0x0206FC80
VENDOR_STATUS = 0x0206FCC0

NUMBER_MASK = 0x3F

# Control modes.
VOLTAGE, VELOCITY, POSITION, CURRENT, VOLTAGE_COMPENSATION, FOLLOWER = range(6)
NO_DRIVE = 15

# Vendor command error codes.
(NO_ERROR, NOT_SUPPORTED, BAD_PARAMETER, DATA_RECEIVE_MORE, IN_BOOTLOADER, CRC_MISMATCH,
 FLASH_WRITE_FAILED, ACK_RESET, TEST_PASSED, TEST_FAILED) = range(10)

# Pins named by a failed self-test (high byte of the error code).
PIN_AIN1, PIN_FORWARD_LIMIT, PIN_REVERSE_LIMIT, PIN_QEA, PIN_QEB, PIN_INDEX = range(1, 7)

# Vendor commands.
SET_DEVICE_NUMBER = 0x01
SET_DEVICE_NAME = 0x02
SET_MANUFACTURER_NAME = 0x03
SET_PRODUCT_NAME = 0x04
SET_MANUFACTURE_DATE = 0x05
SET_HARDWARE_VERSION = 0x06
SET_SERIAL_NUMBER = 0x07
FLASH_LEDS = 0x50
GET_DESCRIPTORS = 0x60
GET_FIRMWARE_VERSION = 0x61
GET_FLASH_SEQUENCE_NUMBER = 0x62
ENTER_BOOTLOADER = 0xF0
SOFT_RESET = 0xF1
ERASE_WRITE_FLASH_PAGE = 0xF2
J1_SHORT_TEST = 0xF3
J1_OPEN_TEST = 0xF4

# Image types.
APPLICATION, BOOTLOADER = 0, 1

# Parameter error codes.
PARAM_NO_ERROR, PARAM_BAD_PARAMETER, PARAM_BAD_VALUE = range(3)

# Parameters.
FWD_NORMALLY_CLOSED, FWD_DISABLED, REV_NORMALLY_CLOSED, REV_DISABLED = 1, 2, 3, 4
SOFT_FWD_THRESHOLD, SOFT_FWD_ENABLE, SOFT_REV_THRESHOLD, SOFT_REV_ENABLE = 5, 6, 7, 8
ADC_CURRENT_MULTIPLIER = 9
P_GAIN, I_GAIN, D_GAIN, I_ZONE, F_GAIN = 10, 11, 12, 13, 14
ALLOWABLE_ERROR, RAMP_RATE = 15, 16
FWD_MAX, REV_MAX, FWD_NOMINAL, REV_NOMINAL = 17, 18, 19, 20
SLOT_1 = 11  # add to a parameter of slot 0 to get the same one of slot 1
LIMIT_P, LIMIT_I, LIMIT_D, LIMIT_I_ZONE, LIMIT_F = 32, 33, 34, 35, 36
ENCODER_POSITION, CLEAR_ON_INDEX, CLEAR_ON_FWD_LIMIT, CLEAR_ON_REV_LIMIT = 41, 42, 43, 44
INDEX_ACTIVE_EDGE = 45
ACTIVE_FAULTS, STICKY_FAULTS = 51, 52
# This project's own: how the controller started (docs/resets.md).
RESET_CAUSE, RESET_DETAIL, FRAMES_DROPPED, RESET_COUNT, RESET_PLACE = 130, 132, 133, 134, 135
CRASH_CAUSE, CRASH_DETAIL, CRASH_PLACE = 153, 154, 155
RESET_POWER_ON, RESET_REQUESTED = 1, 4
RESET_PANIC, RESET_FAULT, RESET_INTERRUPT, RESET_STACK = 6, 7, 8, 9
COUNT_OVER_CURRENT, COUNT_OVER_TEMPERATURE, COUNT_UNDER_VOLTAGE = 53, 54, 55
COUNT_GATE_DRIVER, COUNT_COMMUNICATION = 56, 57
CONTINUOUS_LIMIT, PEAK_LIMIT, PEAK_DURATION, CURRENT_LIMIT_ENABLE = 61, 62, 63, 64
ANALOG_PERIOD, ENCODER_PERIOD, GENERAL_PERIOD = 91, 92, 93

# Faults.
FAULT_OVER_CURRENT, FAULT_OVER_TEMPERATURE, FAULT_UNDER_VOLTAGE = 0x01, 0x02, 0x04
FAULT_GATE_DRIVER, FAULT_COMMUNICATION = 0x08, 0x10

TICK_US = 500
HEARTBEAT_US = 104_000
FULL = 32767


class Frame(NamedTuple):
    """A CAN frame: identifier, data, 29-bit or not, remote or not."""

    id: int
    data: bytes = b""
    ext: bool = True
    rtr: bool = False
    dlc: int = -1  # only for remote frames; -1 means the length of the data

    @property
    def length(self) -> int:
        return len(self.data) if self.dlc < 0 else self.dlc


def fixed(value: float) -> int:
    """A number as 16.16 fixed point."""
    return round(value * 65536)


# --- from host to controller ---------------------------------------------------------------


def enumerate_request() -> Frame:
    return Frame(ENUM)


def vendor_command(number: int, session: int, command: int, parameter1=0, parameter2=0) -> Frame:
    data = struct.pack("<HHHH", session, command, parameter1, parameter2)
    return Frame(VENDOR_COMMAND | number, data)


def data_out(number: int, payload: bytes, chunk: int = 8) -> list:
    """The payload of a vendor command, split into frames of at most eight bytes."""
    parts = [payload[i:i + chunk] for i in range(0, len(payload), chunk)]
    return [Frame(VENDOR_DATA_OUT | number, part) for part in parts]


def param_request(number: int, session: int, parameter: int) -> Frame:
    return Frame(PARAM_REQUEST | number, struct.pack("<HB", session, parameter))


def param_set(number: int, session: int, parameter: int, value: int) -> Frame:
    data = struct.pack("<HBI", session, parameter, value & 0xFFFFFFFF)
    return Frame(PARAM_SET | number, data)


def control(number, mode, target=0, *, slot=0, ramp=0, brake=None, reverse_sensor=False,
            reverse_motor=False, limit_override=False, disable_fwd_limit=False,
            disable_rev_limit=False) -> Frame:
    """A control frame. `target` is the signed 24-bit raw value; `brake` None leaves the stored
    setting, True brakes and False coasts."""
    fs0 = mode | (brake is not None) << 4 | bool(brake) << 5 | slot << 6 | reverse_sensor << 7
    fs1 = (int(reverse_motor) | disable_fwd_limit << 1 | disable_rev_limit << 2
           | limit_override << 3)
    raw = target & 0xFFFFFF
    high, middle, low = raw >> 16, raw >> 8 & 0xFF, raw & 0xFF
    return Frame(CONTROL_0 | number,
                 bytes([fs0, fs1, 0, high, low, middle]) + struct.pack("<H", ramp))


def follow(number: int, master: int, **options) -> Frame:
    """Follower mode. The two ignored bytes of the target are filled with ones on purpose."""
    return control(number, FOLLOWER, 0xFFFF00 | master, **options)


# --- from controller to host ---------------------------------------------------------------


class EnumResponse0(NamedTuple):
    session: int
    product: int


class EnumResponse1(NamedTuple):
    session: int
    flags: int
    application_version: int
    bootloader_version: int

    @property
    def image(self) -> int:
        return self.flags & 0b11


def enum_response(data: bytes):
    """Both answers share one identifier; the length tells them apart."""
    if len(data) == 6:
        return EnumResponse0(*struct.unpack("<HI", data))
    if len(data) == 8:
        return EnumResponse1(*struct.unpack("<HHHH", data))
    raise ValueError(f"an enumeration answer has 6 or 8 bytes, not {len(data)}")


class VendorStatus(NamedTuple):
    error: int
    count: int


def vendor_status(data: bytes) -> VendorStatus:
    if len(data) != 4:
        raise ValueError(f"VENDORSTS has 4 bytes, not {len(data)}")
    return VendorStatus(*struct.unpack("<HH", data))


class FirmwareVersion(NamedTuple):
    flags: int
    application: int
    bootloader: int


def firmware_version(data: bytes) -> FirmwareVersion:
    return FirmwareVersion(*struct.unpack("<HHH", data))


def descriptors(stream: bytes) -> dict:
    """The field separated stream as {field: text}; raises when a field is cut short."""
    fields, at = {}, 0
    while at < len(stream):
        field, count = stream[at], stream[at + 1]
        text = stream[at + 2:at + 2 + count]
        if len(text) != count:
            raise ValueError(f"field {field} claims {count} bytes, {len(text)} are left")
        fields[field] = text.decode("ascii")
        at += 2 + count
    return fields


class ParamResponse(NamedTuple):
    parameter: int
    value: int
    error: int

    @property
    def signed(self) -> int:
        return self.value - (1 << 32) if self.value >> 31 else self.value


def param_response(data: bytes) -> ParamResponse:
    if len(data) != 6:
        raise ValueError(f"PARAMRESP has 6 bytes, not {len(data)}")
    return ParamResponse(*struct.unpack("<BIB", data))


def signed24(high: int, middle: int, low: int) -> int:
    raw = high << 16 | middle << 8 | low
    return raw - (1 << 24) if raw >> 23 else raw


class General:
    """STSGENERAL."""

    def __init__(self, data: bytes):
        if len(data) != 8:
            raise ValueError(f"STSGENERAL has 8 bytes, not {len(data)}")
        self.duty = struct.unpack_from("<h", data)[0]
        fs0, fs1, fs2 = data[2], data[3], data[4]
        self.fwd_pin, self.fwd_hit, self.fwd_disabled, self.fwd_normally_closed = (
            bool(fs0 >> bit & 1) for bit in range(4))
        self.rev_pin, self.rev_hit, self.rev_disabled, self.rev_normally_closed = (
            bool(fs0 >> bit & 1) for bit in range(4, 8))
        (self.limit_override, self.fwd_disable_override, self.rev_disable_override,
         self.soft_fwd_hit, self.soft_fwd_enabled, self.soft_rev_hit, self.soft_rev_enabled,
         self.current_limit_active) = (bool(fs1 >> bit & 1) for bit in range(8))
        self.over_temperature = bool(fs2 & 1)
        self.under_voltage = bool(fs2 & 2)
        self.gate_driver = bool(fs2 & 4)
        self.mode = fs2 >> 3 & 0xF
        self.error_divided = bool(fs2 & 0x80)
        self.error_raw = signed24(data[7], data[6], data[5])

    @property
    def error(self) -> int:
        return self.error_raw * 256 if self.error_divided else self.error_raw


class Encoder:
    """STSENCODER: the one frame with its high bytes first."""

    def __init__(self, data: bytes):
        if len(data) != 8:
            raise ValueError(f"STSENCODER has 8 bytes, not {len(data)}")
        self.position_raw = signed24(data[0], data[1], data[2])
        self.velocity_raw = struct.unpack_from(">h", data, 3)[0]
        self.reserved = data[5:7]
        flags = data[7]
        self.position_divided, self.velocity_divided = bool(flags & 1), bool(flags & 2)
        self.pin_a, self.pin_b, self.pin_index = (bool(flags >> bit & 1) for bit in (2, 3, 4))

    @property
    def position(self) -> int:
        return self.position_raw * 8 if self.position_divided else self.position_raw

    @property
    def velocity(self) -> int:
        return self.velocity_raw * 4 if self.velocity_divided else self.velocity_raw


class Analog:
    """STSANALOG: volts at AIN1, amps, degrees Celsius, volts of the bus; each signed 8.8."""

    def __init__(self, data: bytes):
        if len(data) != 8:
            raise ValueError(f"STSANALOG has 8 bytes, not {len(data)}")
        self.ain1, self.current, self.temperature, self.bus = (
            raw / 256 for raw in struct.unpack("<hhhh", data))
