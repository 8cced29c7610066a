"""Enumeration and device discovery: who answers, when, and how duplicates are told apart."""

import struct
import unittest

import dmc60c
from dmc60c import Frame
from windlass_bench import BenchTest

REQUEST_LOW_BITS = 0x245  # the enumeration identifier with a number in its low six bits


def is_answer(seen) -> bool:
    return seen.from_node and seen.base == dmc60c.ENUM_RESPONSE


class Answers(BenchTest):
    def test_two_answers_with_their_lengths_and_fields(self):
        trace = self.exchange(dmc60c.enumerate_request(), us=100_000)
        answers = [seen for seen in trace if is_answer(seen)]
        self.assertEqual([seen.dlc for seen in answers], [6, 8])
        self.assertEqual([seen.number for seen in answers], [0, 0])
        first = dmc60c.enum_response(answers[0].data)
        second = dmc60c.enum_response(answers[1].data)
        self.assertEqual(first.session, second.session)
        self.assertNotEqual(first.session, 0, "a session id is never 0")
        self.assertEqual(first.product >> 20, 0x602, "product identifier of the DMC60 family")
        self.assertEqual(second.image, dmc60c.APPLICATION)
        self.assertEqual(second.flags & 0xFFFC, 0, "reserved flags read 0")
        self.assertGreaterEqual(second.application_version, 0x0117, "the guide is for 1.23")
        self.assertNotEqual(second.application_version, 0xFFFF)
        self.assertGreaterEqual(second.bootloader_version, 0x0109, "the guide is for 1.9")

    def test_second_answer_follows_the_first_directly(self):
        trace = self.exchange(dmc60c.enumerate_request(), us=100_000)
        first, second = [seen for seen in trace if is_answer(seen)]
        self.assertLess(second.t_us - first.t_us, 1_500)

    def test_low_bits_and_length_of_the_request_do_not_matter(self):
        for request in (Frame(REQUEST_LOW_BITS), Frame(dmc60c.ENUM, bytes(8)),
                        Frame(dmc60c.ENUM | 0x3F, bytes(3))):
            with self.subTest(request=request):
                trace = self.exchange(request, us=100_000)
                self.assertEqual(sum(map(is_answer, trace)), 2)

    def test_request_to_another_type_or_manufacturer_or_api_is_not_answered(self):
        self.enumerate()
        for identifier in (0x02000240, 0x00060240, 0x02060240, 0x00000280, 0x00000200, 0x00000640):
            with self.subTest(identifier=hex(identifier)):
                trace = self.exchange(Frame(identifier), us=70_000)
                self.assertEqual(sum(map(is_answer, trace)), 0)

    def test_remote_and_short_identifiers_are_not_answered(self):
        self.enumerate()
        for request in (Frame(dmc60c.ENUM, ext=True, rtr=True, dlc=0),
                        Frame(dmc60c.ENUM, ext=False), Frame(0, ext=False)):
            with self.subTest(request=request):
                trace = self.exchange(request, us=70_000)
                self.assertEqual(sum(map(is_answer, trace)), 0)

    def test_request_during_a_pending_answer_is_dropped(self):
        session = self.one().session
        delay_us = max(session & 0x7F, 1) * dmc60c.TICK_US
        if delay_us < 2_000:
            self.skipTest("this session answers too early to ask twice")
        trace = self.exchange(dmc60c.enumerate_request(), us=500)
        trace += self.exchange(dmc60c.enumerate_request(), us=150_000)
        self.assertEqual(sum(map(is_answer, trace)), 2)

    def test_the_request_that_wakes_the_bus_is_answered(self):
        self.assertEqual(len(self.enumerate()), 1)

    def test_silent_before_the_first_frame_on_the_bus(self):
        self.assertEqual(self.step(500_000), [])

    def test_an_eleven_bit_frame_is_enough_to_be_noticed(self):
        self.exchange(Frame(0x7FF, b"\1\2", ext=False), us=20_000)
        trace = self.step(20_000)
        self.assertTrue(self.pick(trace, dmc60c.STATUS_GENERAL))


class DelayOfTheUnnumbered(BenchTest):
    """Number 0: the delay is the low seven bits of the session id in ticks, 0 counting as 1."""

    def reconnect(self):
        self.bench.poke(0, bus_connected=False)
        self.step(200_000)
        self.bench.poke(0, bus_connected=True)
        self.step(50_000)

    def test_delay_derives_from_the_session_id(self):
        sessions = set()
        for _ in range(12):
            trace = self.exchange(dmc60c.enumerate_request(), us=100_000)
            request = next(seen for seen in trace if not seen.from_node)
            first = next(seen for seen in trace if is_answer(seen))
            session = dmc60c.enum_response(first.data).session
            sessions.add(session)
            wanted = max(session & 0x7F, 1) * dmc60c.TICK_US
            delay = first.t_us - request.t_us
            self.assertGreaterEqual(wanted, 500)
            self.assertLessEqual(wanted, 63_500)
            self.assertGreaterEqual(delay, wanted - dmc60c.TICK_US)
            self.assertLessEqual(delay, wanted + 3 * dmc60c.TICK_US)
            self.reconnect()
        self.assertGreater(len(sessions), 6, "each connection draws its own session id")


class DelayOfTheNumbered(BenchTest):
    NODES = ("dmc60c:1", "dmc60c:20", "dmc60c:63")

    def test_delay_is_the_device_number_in_milliseconds(self):
        trace = self.exchange(dmc60c.enumerate_request(), us=100_000)
        request = next(seen for seen in trace if not seen.from_node)
        first = {}
        for seen in trace:
            if is_answer(seen):
                first.setdefault(seen.number, seen.t_us - request.t_us)
        self.assertEqual(list(first), [1, 20, 63])
        for number, delay in first.items():
            wanted = 2 * number * dmc60c.TICK_US
            self.assertGreaterEqual(delay, wanted - dmc60c.TICK_US)
            self.assertLessEqual(delay, wanted + 3 * dmc60c.TICK_US)


class Duplicates(BenchTest):
    NODES = ("dmc60c:0", "dmc60c:0")

    def found_both(self):
        for _ in range(4):  # answers that destroy each other are lost; a host asks again
            found = self.enumerate()
            if len(found) == 2:
                return found
        self.fail(f"two controllers with number 0, found {found}")

    def test_one_of_two_with_the_same_number_is_renumbered(self):
        left, right = self.found_both()
        self.assertEqual((left.number, right.number), (0, 0))
        self.assertNotEqual(left.session, right.session)

        status, _ = left.command(dmc60c.SET_DEVICE_NUMBER, 5)
        self.assertEqual(status, (dmc60c.NO_ERROR, 0))
        left.number = 5
        self.assertEqual(left.set_text(dmc60c.SET_DEVICE_NAME, "arm"), (dmc60c.NO_ERROR, 0))
        self.assertEqual(left.descriptors()[1], "arm")
        self.assertEqual(right.descriptors()[1], "Motor Controller")

        found = {device.number: device.session for device in self.found_both()}
        self.assertEqual(found, {5: left.session, 0: right.session})

        for device, gain in ((left, 111), (right, 222)):
            device.set(dmc60c.P_GAIN, gain)
        self.assertEqual((left.get(dmc60c.P_GAIN), right.get(dmc60c.P_GAIN)), (111, 222))

        for device, duty in ((left, 4_000), (right, -4_000)):
            trace = device.run(dmc60c.VOLTAGE, duty, 60_000)
            self.assertEqual(device.general(trace).duty, duty)
        numbers = {self.bench.node(index)["number"] for index in range(2)}
        self.assertEqual(numbers, {0, 5})

    def test_both_are_alive_for_seconds(self):
        left, right = self.found_both()
        trace = self.step(3_000_000)
        sources = {seen.source for seen in self.pick(trace, dmc60c.STATUS_GENERAL)}
        self.assertEqual(sources, {0, 1})
        self.assertEqual({device.session for device in self.found_both()},
                         {left.session, right.session})


class Renumbering(BenchTest):
    NODES = ("dmc60c:7",)

    def test_answer_carries_the_new_number_and_so_does_everything_after(self):
        device = self.one()
        self.assertEqual(device.number, 7)
        trace = self.exchange(
            dmc60c.vendor_command(7, device.session, dmc60c.SET_DEVICE_NUMBER, 42), us=60_000)
        (reply,) = self.pick(trace, dmc60c.VENDOR_STATUS)
        self.assertEqual((reply.number, reply.data), (42, struct.pack("<HH", 0, 0)))
        later = [seen for seen in trace if seen.from_node and seen.t_us > reply.t_us]
        self.assertTrue(later)
        self.assertEqual({seen.number for seen in later}, {42})
        device.number = 42
        self.assertEqual(device.get(dmc60c.GENERAL_PERIOD), 10)
        silent = self.exchange(dmc60c.param_request(7, device.session, dmc60c.P_GAIN))
        self.assertEqual(self.pick(silent, dmc60c.PARAM_RESPONSE), [])

    def test_numbers_out_of_range_are_refused_from_the_old_number(self):
        device = self.one()
        for number in (0, 64, 65, 0xFFFF, 0x0105):
            with self.subTest(number=number):
                trace = self.exchange(dmc60c.vendor_command(
                    7, device.session, dmc60c.SET_DEVICE_NUMBER, number))
                (reply,) = self.pick(trace, dmc60c.VENDOR_STATUS)
                self.assertEqual(reply.number, 7)
                self.assertEqual(dmc60c.vendor_status(reply.data), (dmc60c.BAD_PARAMETER, 0))
        self.assertEqual(self.one().number, 7)

    def test_the_limits_of_the_range_are_accepted(self):
        device = self.one()
        for number in (1, 63):
            status, _ = device.command(dmc60c.SET_DEVICE_NUMBER, number)
            self.assertEqual(status, (dmc60c.NO_ERROR, 0))
            device.number = number
        self.assertEqual(self.one().number, 63)

    def test_the_number_survives_the_power(self):
        device = self.one()
        device.command(dmc60c.SET_DEVICE_NUMBER, 9)
        self.bench.power_cycle(0)
        self.step(500_000)
        self.assertEqual(self.one().number, 9)


if __name__ == "__main__":
    unittest.main()
