"""Vendor commands: strings, descriptors, versions, errors, resets and the self-tests."""

import struct
import unittest

import dmc60c
from dmc60c import Frame
from windlass_bench import BenchTest

# Field identifier, command and the longest text of each descriptor (without its terminator).
TEXTS = {
    1: (dmc60c.SET_DEVICE_NAME, 64),
    2: (dmc60c.SET_MANUFACTURER_NAME, 28),
    3: (dmc60c.SET_PRODUCT_NAME, 28),
    4: (dmc60c.SET_MANUFACTURE_DATE, 20),
    5: (dmc60c.SET_HARDWARE_VERSION, 8),
    6: (dmc60c.SET_SERIAL_NUMBER, 12),
}
DEFAULTS = {1: "Motor Controller", 2: "Digilent", 3: "Digilent DMC60C",
            4: "UNKNOWN", 5: "UNKNOWN", 6: "UNKNOWN"}


class Descriptors(BenchTest):
    def test_defaults_in_the_order_of_their_fields(self):
        fields = self.one().descriptors()
        self.assertEqual(fields, DEFAULTS)
        self.assertEqual(list(fields), [1, 2, 3, 4, 5, 6])

    def test_status_comes_first_and_data_in_full_frames(self):
        device = self.one()
        trace = self.exchange(dmc60c.vendor_command(0, device.session, dmc60c.GET_DESCRIPTORS),
                              us=20_000)
        vendor = [seen for seen in trace if seen.from_node
                  and seen.base in (dmc60c.VENDOR_STATUS, dmc60c.VENDOR_DATA_IN)]
        self.assertEqual(vendor[0].base, dmc60c.VENDOR_STATUS)
        count = dmc60c.vendor_status(vendor[0].data).count
        self.assertEqual(count, sum(2 + len(text) for text in DEFAULTS.values()))
        lengths = [seen.dlc for seen in vendor[1:]]
        self.assertEqual(lengths, [8] * (count // 8) + ([count % 8] if count % 8 else []))

    def test_each_text_at_its_greatest_length(self):
        device = self.one()
        wanted = {}
        for field, (command, longest) in TEXTS.items():
            wanted[field] = (chr(ord("a") + field) * longest)
            self.assertEqual(device.set_text(command, wanted[field]), (dmc60c.NO_ERROR, 0), field)
        self.assertEqual(device.descriptors(), wanted)
        self.assertEqual(self.pick(self.step(50_000), dmc60c.VENDOR_STATUS), [])

    def test_one_character_more_is_a_bad_parameter_at_once(self):
        device = self.one()
        for field, (command, longest) in TEXTS.items():
            with self.subTest(field=field):
                status, _ = device.command(command, longest + 2)
                self.assertEqual(status, (dmc60c.BAD_PARAMETER, 0))
        self.assertEqual(device.descriptors(), DEFAULTS)

    def test_a_length_of_zero_is_a_bad_parameter(self):
        device = self.one()
        for command, _ in TEXTS.values():
            status, _ = device.command(command, 0)
            self.assertEqual(status, (dmc60c.BAD_PARAMETER, 0))

    def test_an_empty_text_is_its_terminator_alone(self):
        device = self.one()
        self.assertEqual(device.set_text(dmc60c.SET_DEVICE_NAME, ""), (dmc60c.NO_ERROR, 0))
        self.assertEqual(device.descriptors()[1], "")

    def test_texts_survive_the_power_and_a_reset(self):
        device = self.one()
        device.set_text(dmc60c.SET_SERIAL_NUMBER, "2103343A79F2")
        self.bench.power_cycle(0)
        self.step(500_000)
        self.assertEqual(self.one().descriptors()[6], "2103343A79F2")


class DataOut(BenchTest):
    def test_chunks_of_any_length(self):
        device = self.one()
        for chunk in (1, 3, 7):
            text = f"chunks of {chunk}"
            status, _ = device.command(dmc60c.SET_DEVICE_NAME, len(text) + 1,
                                       payload=text.encode() + b"\0", chunk=chunk, us=30_000)
            self.assertEqual(status, (dmc60c.NO_ERROR, 0))
            self.assertEqual(device.descriptors()[1], text)

    def test_no_status_before_the_last_byte(self):
        device = self.one()
        status, _ = device.command(dmc60c.SET_DEVICE_NAME, 9, payload=b"12345678", us=100_000)
        self.assertIsNone(status)
        trace = self.exchange(Frame(dmc60c.VENDOR_DATA_OUT, b"\0"))
        (reply,) = self.pick(trace, dmc60c.VENDOR_STATUS)
        self.assertEqual(dmc60c.vendor_status(reply.data), (dmc60c.NO_ERROR, 0))

    def test_a_byte_too_many_cancels_and_writes_nothing(self):
        device = self.one()
        status, _ = device.command(dmc60c.SET_DEVICE_NAME, 4, payload=b"abcd\0")
        self.assertEqual(status, (dmc60c.DATA_RECEIVE_MORE, 0))
        self.assertEqual(device.descriptors()[1], DEFAULTS[1])
        trace = self.exchange(Frame(dmc60c.VENDOR_DATA_OUT, b"x"))
        self.assertEqual(self.pick(trace, dmc60c.VENDOR_STATUS), [], "the transfer is over")

    def test_a_new_command_aborts_the_transfer(self):
        device = self.one()
        status, _ = device.command(dmc60c.SET_DEVICE_NAME, 16, payload=b"half way")
        self.assertIsNone(status)
        status, data = device.command(dmc60c.GET_FIRMWARE_VERSION)
        self.assertEqual(status, (dmc60c.NO_ERROR, len(data)))
        trace = self.exchange(Frame(dmc60c.VENDOR_DATA_OUT, b"to it \0\0"))
        self.assertEqual(self.pick(trace, dmc60c.VENDOR_STATUS), [])
        self.assertEqual(device.descriptors()[1], DEFAULTS[1])

    def test_data_without_a_command_is_ignored(self):
        self.one()
        trace = self.exchange(Frame(dmc60c.VENDOR_DATA_OUT, bytes(8)))
        self.assertEqual(self.pick(trace, dmc60c.VENDOR_STATUS), [])

    def test_a_new_command_discards_data_not_yet_sent(self):
        device = self.one()
        trace = self.exchange(
            dmc60c.vendor_command(0, device.session, dmc60c.GET_DESCRIPTORS),
            dmc60c.vendor_command(0, device.session, dmc60c.GET_FIRMWARE_VERSION), us=20_000)
        replies = self.pick(trace, dmc60c.VENDOR_STATUS)
        last = dmc60c.vendor_status(replies[-1].data)
        self.assertEqual(last, (dmc60c.NO_ERROR, 6))
        after = [seen for seen in self.pick(trace, dmc60c.VENDOR_DATA_IN)
                 if seen.t_us > replies[-1].t_us]
        self.assertEqual([seen.dlc for seen in after], [6])

    def test_an_unterminated_text_never_reads_past_its_bytes(self):
        device = self.one()
        device.set_text(dmc60c.SET_DEVICE_NAME, "a long old name")
        status, _ = device.command(dmc60c.SET_DEVICE_NAME, 3, payload=b"abc")
        self.assertIn(status.error, (dmc60c.NO_ERROR, dmc60c.BAD_PARAMETER))
        self.assertIn(device.descriptors()[1], ("ab", "abc", "a long old name"))


class Versions(BenchTest):
    def test_firmware_version_agrees_with_the_enumeration(self):
        device = self.one()
        status, data = device.command(dmc60c.GET_FIRMWARE_VERSION)
        self.assertEqual(status, (dmc60c.NO_ERROR, 6))
        self.assertEqual(dmc60c.firmware_version(data), (
            dmc60c.APPLICATION, device.second.application_version,
            device.second.bootloader_version))

    def sequence_number(self, device) -> int:
        status, data = device.command(dmc60c.GET_FLASH_SEQUENCE_NUMBER)
        self.assertEqual(status, (dmc60c.NO_ERROR, 4))
        return struct.unpack("<I", data)[0]

    def test_sequence_number_counts_the_writes(self):
        device = self.one()
        before = self.sequence_number(device)
        self.assertEqual(self.sequence_number(device), before, "reading writes nothing")
        device.set_text(dmc60c.SET_DEVICE_NAME, "counted")
        self.assertEqual(self.sequence_number(device), before + 1)


class Errors(BenchTest):
    def test_unknown_commands_are_not_supported(self):
        device = self.one()
        for command in (0x00, 0x08, 0x4F, 0x51, 0x63, 0xEF, 0xF5, 0xFF, 0x0161, 0x6161):
            with self.subTest(command=hex(command)):
                status, data = device.command(command)
                self.assertEqual((status, data), ((dmc60c.NOT_SUPPORTED, 0), b""))

    def test_page_writes_are_not_supported_by_the_application(self):
        device = self.one()
        for image in (0, 1, 2):
            status, _ = device.command(dmc60c.ERASE_WRITE_FLASH_PAGE, image, 30)
            self.assertEqual(status, (dmc60c.NOT_SUPPORTED, 0))

    def test_wrong_sessions_are_not_answered(self):
        device = self.one()
        for session in (0, 0xFFFF, device.session ^ 1, device.session ^ 0x8000):
            with self.subTest(session=session):
                trace = self.exchange(
                    dmc60c.vendor_command(0, session, dmc60c.GET_DESCRIPTORS),
                    dmc60c.param_request(0, session, dmc60c.P_GAIN),
                    dmc60c.param_set(0, session, dmc60c.P_GAIN, 77))
                for base in (dmc60c.VENDOR_STATUS, dmc60c.VENDOR_DATA_IN, dmc60c.PARAM_RESPONSE):
                    self.assertEqual(self.pick(trace, base), [])
        self.assertEqual(device.get(dmc60c.P_GAIN), 0)

    def test_a_command_has_exactly_eight_bytes(self):
        device = self.one()
        whole = dmc60c.vendor_command(0, device.session, dmc60c.GET_FIRMWARE_VERSION).data
        for length in range(8):
            trace = self.exchange(Frame(dmc60c.VENDOR_COMMAND, whole[:length]), us=2_000)
            self.assertEqual(self.pick(trace, dmc60c.VENDOR_STATUS), [], length)

    def test_a_command_for_another_number_is_not_answered(self):
        device = self.one()
        trace = self.exchange(
            dmc60c.vendor_command(1, device.session, dmc60c.GET_FIRMWARE_VERSION),
            dmc60c.vendor_command(63, device.session, dmc60c.GET_FIRMWARE_VERSION))
        self.assertEqual(self.pick(trace, dmc60c.VENDOR_STATUS), [])


class Resets(BenchTest):
    NODES = ("dmc60c:12",)

    def unsolicited(self, command: int):
        """Sends a reset command; returns the status that comes after the reset, and its trace."""
        device = self.one()
        trace = self.exchange(dmc60c.vendor_command(12, device.session, command), us=5_000)
        for _ in range(40):
            replies = self.pick(trace, dmc60c.VENDOR_STATUS)
            if replies:
                break
            trace += self.step(50_000)
        self.assertEqual(len(replies), 1)
        self.assertEqual(replies[0].number, 12)
        return device, dmc60c.vendor_status(replies[0].data)

    def test_enter_bootloader_answers_from_the_bootloader_with_the_same_session(self):
        device, status = self.unsolicited(dmc60c.ENTER_BOOTLOADER)
        self.assertEqual(status, (dmc60c.IN_BOOTLOADER, 0))
        self.assertEqual(self.bench.node()["mode"], "bootloader")
        again = self.one()
        self.assertEqual((again.session, again.number), (device.session, 12))
        self.assertEqual(again.second.image, dmc60c.BOOTLOADER)
        status, data = again.command(dmc60c.GET_FIRMWARE_VERSION)
        self.assertEqual(dmc60c.firmware_version(data).flags & 3, dmc60c.BOOTLOADER)

    def test_bootloader_asked_for_the_bootloader_answers_without_a_reset(self):
        device, _ = self.unsolicited(dmc60c.ENTER_BOOTLOADER)
        status, _ = device.command(dmc60c.ENTER_BOOTLOADER, us=2_000)
        self.assertEqual(status, (dmc60c.IN_BOOTLOADER, 0))
        self.assertEqual(self.one().session, device.session)

    def test_bootloader_does_not_drive_and_sends_no_status_frames(self):
        device, _ = self.unsolicited(dmc60c.ENTER_BOOTLOADER)
        trace = device.run(dmc60c.VOLTAGE, 20_000, 300_000)
        self.assertEqual(self.duty(), 0)
        for base in (dmc60c.STATUS_GENERAL, dmc60c.STATUS_ENCODER, dmc60c.STATUS_ANALOG):
            self.assertEqual(self.pick(trace, base), [])

    def test_soft_reset_leads_back_to_the_application(self):
        device, _ = self.unsolicited(dmc60c.ENTER_BOOTLOADER)
        device, status = self.unsolicited(dmc60c.SOFT_RESET)
        self.assertEqual(status, (dmc60c.ACK_RESET, 0))
        again = self.one()
        self.assertEqual(again.session, device.session)
        self.assertEqual(again.second.image, dmc60c.APPLICATION)
        self.assertEqual(self.bench.node()["mode"], "application")

    def test_soft_reset_of_the_application_keeps_the_session_and_stops_the_motor(self):
        device = self.one()
        device.run(dmc60c.VOLTAGE, 10_000, 200_000)
        device, status = self.unsolicited(dmc60c.SOFT_RESET)
        self.assertEqual(status, (dmc60c.ACK_RESET, 0))
        self.assertEqual(self.duty(), 0)
        self.assertEqual(self.one().session, device.session)

    def test_the_cause_of_the_start_is_told_and_restarts_are_counted(self):
        def told(device):
            return device.get(dmc60c.RESET_CAUSE), device.get(dmc60c.RESET_COUNT)

        self.assertEqual(told(self.one()), (dmc60c.RESET_POWER_ON, 0))
        for count in (1, 2):
            device, _ = self.unsolicited(dmc60c.SOFT_RESET)
            self.assertEqual(told(device), (dmc60c.RESET_REQUESTED, count))
        self.bench.power_cycle(0)
        self.step(500_000)
        self.assertEqual(told(self.one()), (dmc60c.RESET_POWER_ON, 0))

    def test_power_cycle_leaves_the_bootloader(self):
        device, _ = self.unsolicited(dmc60c.ENTER_BOOTLOADER)
        self.bench.power_cycle(0)
        self.step(500_000)
        again = self.one()
        self.assertEqual(again.second.image, dmc60c.APPLICATION)


class PinTests(BenchTest):
    """The self-tests of header J1. The result's high byte names the last pin that failed."""

    def result(self, command: int) -> int:
        status, _ = self.one().command(command, us=200_000)
        self.assertIsNotNone(status, "the test ends within 200 ms")
        self.assertEqual(status.count, 0)
        return status.error

    def test_no_short_circuit(self):
        self.assertEqual(self.result(dmc60c.J1_SHORT_TEST), dmc60c.TEST_PASSED)

    def test_a_pin_tied_to_ground_is_a_short_circuit(self):
        self.bench.poke(0, fwd_limit_closed=True)
        self.assertEqual(self.result(dmc60c.J1_SHORT_TEST),
                         dmc60c.TEST_FAILED | dmc60c.PIN_FORWARD_LIMIT << 8)

    def test_open_test_fails_without_the_loopback_fixture(self):
        error = self.result(dmc60c.J1_OPEN_TEST)
        self.assertEqual(error & 0xFF, dmc60c.TEST_FAILED)
        self.assertIn(error >> 8, range(dmc60c.PIN_AIN1, dmc60c.PIN_INDEX + 1))

    def test_open_test_passes_with_the_fixture(self):
        self.bench.poke(0, j1_loopback=True)
        self.assertEqual(self.result(dmc60c.J1_OPEN_TEST), dmc60c.TEST_PASSED)


if __name__ == "__main__":
    unittest.main()
