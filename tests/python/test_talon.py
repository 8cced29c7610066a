"""A Talon SRX as python-can sees it over SLCAN: status, drive, limits, parameters, management."""

import struct

import dmc60c
import talon
from dmc60c import Frame
from windlass_bench import BenchTest

NUMBER = 3


class TalonTest(BenchTest):
    NODES = ("talon:3", "dmc60c:3")

    def general(self, trace) -> talon.General:
        return talon.general(self.last(trace, talon.STATUS_1, NUMBER).data)

    def drive(self, us: int, **told) -> list:
        """Control_1 every 10 ms."""
        trace = []
        for _ in range(us // 10_000):
            self.send(talon.control(NUMBER, **told))
            trace += self.step(10_000)
        return trace

    def throttle(self) -> int:
        return round(self.duty() * 1023 / 32768)


class Status(TalonTest):
    def test_four_frames_come_with_their_periods_and_follow_a_change(self):
        def counts(trace):
            kinds = (talon.STATUS_1, talon.STATUS_2, talon.STATUS_3, talon.STATUS_4)
            return [len(self.pick(trace, kind, NUMBER)) for kind in kinds]

        self.step(50_000)
        for count, wanted in zip(counts(self.step(1_000_000)), (100, 50, 10, 10)):
            self.assertNear(count, wanted, 1)
        self.exchange(talon.status_periods(NUMBER, 5, 20, 100, 250))
        for count, wanted in zip(counts(self.step(1_000_000)), (200, 50, 10, 4)):
            self.assertNear(count, wanted, 1)

    def test_python_can_receives_what_is_on_the_bus(self):
        trace = self.exchange(talon.control(NUMBER, talon.NO_DRIVE), us=200_000)
        self.assertTrue(self.pick(trace, talon.STATUS_2, NUMBER))


class Drive(TalonTest):
    def test_throttle_drives_and_silence_of_100_ms_ends_it(self):
        trace = self.drive(500_000, mode=talon.DUTY, demand=512)
        self.assertEqual(self.throttle(), 512)
        status = self.general(trace)
        self.assertEqual((status.throttle, status.enabled, status.mode), (512, True, talon.DUTY))
        self.assertGreater(talon.position(self.last(trace, talon.STATUS_2, NUMBER).data), 100)
        self.step(80_000)
        self.assertEqual(self.throttle(), 512)
        trace = self.step(30_000)
        self.assertEqual(self.duty(), 0)
        self.assertFalse(self.general(trace).enabled)

    def test_the_broadcast_disable_acts_at_once(self):
        self.drive(100_000, mode=talon.DUTY, demand=-700)
        self.assertEqual(self.throttle(), -700)
        self.exchange(Frame(talon.DISABLE_ALL, b""), us=2_000)
        self.assertEqual(self.duty(), 0)

    def test_a_closed_switch_stops_its_direction_and_is_a_fault(self):
        self.bench.poke(fwd_limit_closed=True)
        status = self.general(self.drive(100_000, mode=talon.DUTY, demand=talon.FULL))
        self.assertEqual(self.duty(), 0)
        self.assertTrue(status.forward_closed and status.forward_fault)
        self.assertFalse(status.reverse_closed)
        self.drive(100_000, mode=talon.DUTY, demand=-talon.FULL)
        self.assertEqual(self.throttle(), -talon.FULL)

    def test_a_position_loop_uses_the_gain_that_was_set(self):
        self.bench.poke(stall=True)
        self.exchange(talon.param_set(NUMBER, talon.SLOT_0_P, round(0.5 * 2**22)))
        trace = self.drive(100_000, mode=talon.POSITION, demand=1000)
        status = self.general(trace)
        self.assertNear(status.error, 1000, 5)
        self.assertNear(status.throttle, 500, 3)


class Parameters(TalonTest):
    def answer(self, trace) -> tuple:
        answers = self.pick(trace, talon.PARAM_RESPONSE, NUMBER)
        self.assertEqual(len(answers), 1)
        return struct.unpack("<BI", answers[0].data)

    def test_sets_and_requests_are_answered_within_4_ms(self):
        for value in (838_860, 0xFFFF_FFFF, 0):
            set_it = talon.param_set(NUMBER, talon.SLOT_0_P, value)
            self.assertEqual(self.answer(self.exchange(set_it, us=4_000)), (1, value))
            ask = talon.param_request(NUMBER, talon.SLOT_0_P)
            self.assertEqual(self.answer(self.exchange(ask, us=4_000)), (1, value))

    def test_an_unknown_parameter_is_not_answered(self):
        trace = self.exchange(talon.param_request(NUMBER, 200), us=10_000)
        self.assertFalse(self.pick(trace, talon.PARAM_RESPONSE))


class Management(TalonTest):
    def sessions(self, base: int) -> list:
        trace = self.exchange(dmc60c.enumerate_request(), us=100_000)
        frames = [seen for seen in self.pick(trace, base, NUMBER) if seen.dlc == 6]
        return [struct.unpack("<HI", seen.data) for seen in frames]

    def test_both_kinds_answer_under_their_own_identifiers(self):
        (_, product), = self.sessions(talon.ENUM_RESPONSE)
        self.assertEqual(product, 0x20400101)
        (_, product), = self.sessions(dmc60c.ENUM_RESPONSE)
        self.assertEqual(product, 0x60200103)

    def test_a_talon_gets_the_numbers_0_to_62_but_not_63(self):
        (session, _), = self.sessions(talon.ENUM_RESPONSE)
        for number, code in ((63, dmc60c.BAD_PARAMETER), (0, dmc60c.NO_ERROR)):
            command = talon.vendor_command(NUMBER, session, dmc60c.SET_DEVICE_NUMBER, number)
            trace = self.exchange(command, us=60_000)
            status = self.pick(trace, talon.VENDOR_STATUS)[-1]
            self.assertEqual(struct.unpack("<HH", status.data), (code, 0))
        self.assertEqual(self.bench.node()["number"], 0)
        self.assertEqual(self.bench.node(1)["number"], NUMBER, "the DMC60C keeps its own")
