"""Heartbeat, halt, loss of the bus, and frames that must change nothing."""

import random
import unittest

import dmc60c
from dmc60c import Frame
from windlass_bench import BenchTest

DUTY = 7_000


class Heartbeat(BenchTest):
    def setUp(self):
        super().setUp()
        self.device = self.one()

    def start(self, mode=dmc60c.VOLTAGE, target=DUTY, **options) -> int:
        """Sends one control frame; returns the time of its last bit."""
        self.send(self.device.control(mode, target, **options))
        trace = self.step(2_000)
        return next(seen.t_us for seen in trace if not seen.from_node)

    def step_to(self, t_us: int):
        self.step(t_us - self.bench.now)

    def test_output_goes_to_zero_104_ms_after_the_last_frame(self):
        heard = self.start()
        self.assertEqual(self.duty(), DUTY)
        self.step_to(heard + dmc60c.HEARTBEAT_US - dmc60c.TICK_US)
        self.assertEqual(self.duty(), DUTY)
        self.step_to(heard + dmc60c.HEARTBEAT_US + 2 * dmc60c.TICK_US)
        self.assertEqual(self.duty(), 0)

    def test_each_control_frame_starts_it_again(self):
        for _ in range(5):
            heard = self.start()
            self.step_to(heard + 100_000)
            self.assertEqual(self.duty(), DUTY)
        self.step_to(heard + dmc60c.HEARTBEAT_US + 2 * dmc60c.TICK_US)
        self.assertEqual(self.duty(), 0)

    def test_parameters_and_vendor_commands_do_not(self):
        heard = self.start()
        while self.bench.now < heard + 95_000:
            self.device.get(dmc60c.P_GAIN)
            self.device.command(dmc60c.GET_FIRMWARE_VERSION, us=3_000)
        self.step_to(heard + dmc60c.HEARTBEAT_US + 2 * dmc60c.TICK_US)
        self.assertEqual(self.duty(), 0)

    def test_control_frames_for_others_and_of_wrong_length_do_not(self):
        heard = self.start()
        whole = self.device.control(dmc60c.VOLTAGE, DUTY).data
        while self.bench.now < heard + 95_000:
            self.send(dmc60c.control(3, dmc60c.VOLTAGE, DUTY),
                      Frame(dmc60c.CONTROL_0, whole[:7]))
            self.step(5_000)
        self.step_to(heard + dmc60c.HEARTBEAT_US + 2 * dmc60c.TICK_US)
        self.assertEqual(self.duty(), 0)

    def test_closed_loop_modes_time_out_too(self):
        self.device.set(dmc60c.F_GAIN, dmc60c.fixed(1))
        heard = self.start(dmc60c.VELOCITY, 3_000)
        self.assertEqual(self.duty(), 3_000)
        self.step_to(heard + dmc60c.HEARTBEAT_US + 2 * dmc60c.TICK_US)
        self.assertEqual(self.duty(), 0)

    def test_silence_is_no_fault(self):
        self.start()
        self.step(500_000)
        for parameter in range(51, 58):
            self.assertEqual(self.device.get(parameter), 0)

    def test_next_setpoint_ends_the_halt(self):
        self.start()
        self.step(500_000)
        self.start(target=-DUTY)
        self.assertEqual(self.duty(), -DUTY)

    def test_the_session_is_kept_through_a_halt(self):
        self.start()
        self.step(1_000_000)
        self.assertEqual(self.one().session, self.device.session)

    def test_status_frames_go_on_while_halted(self):
        self.step(1_000_000)
        trace = self.step(1_000_000)
        self.assertNear(len(self.pick(trace, dmc60c.STATUS_GENERAL)), 100, 1)


class LossOfTheBus(BenchTest):
    def setUp(self):
        super().setUp()
        self.device = self.one()

    def cut(self):
        self.bench.poke(0, bus_connected=False)

    def join(self):
        self.bench.poke(0, bus_connected=True)

    def test_unacknowledged_frames_end_the_drive_and_the_session(self):
        self.device.run(dmc60c.VOLTAGE, DUTY, 50_000)
        self.cut()
        self.step(60_000)
        self.assertEqual(self.duty(), 0, "lost before the heartbeat ran out")
        self.join()
        self.step(50_000)
        again = self.one()
        self.assertNotEqual(again.session, self.device.session)
        self.assertEqual(again.number, self.device.number)

    def test_the_old_session_is_not_answered_after_the_loss(self):
        self.cut()
        self.step(300_000)
        self.join()
        trace = self.exchange(
            dmc60c.vendor_command(0, self.device.session, dmc60c.GET_FIRMWARE_VERSION),
            dmc60c.param_request(0, self.device.session, dmc60c.P_GAIN), us=50_000)
        self.assertEqual(self.pick(trace, dmc60c.VENDOR_STATUS), [])
        self.assertEqual(self.pick(trace, dmc60c.PARAM_RESPONSE), [])

    def test_settings_in_memory_are_kept(self):
        self.device.configure({dmc60c.P_GAIN: 5, dmc60c.GENERAL_PERIOD: 20,
                               dmc60c.ENCODER_POSITION: 4_321})
        self.cut()
        self.step(300_000)
        self.join()
        self.step(50_000)
        again = self.one()
        self.assertEqual(again.get(dmc60c.P_GAIN), 5)
        self.assertEqual(again.get(dmc60c.GENERAL_PERIOD), 20)
        self.assertEqual(again.get(dmc60c.ENCODER_POSITION), 4_321)

    def test_status_frames_start_again_with_the_bus(self):
        self.cut()
        self.assertEqual(self.pick(self.step(300_000), dmc60c.STATUS_GENERAL), [])
        self.join()
        self.wake()
        self.assertTrue(self.pick(self.step(50_000), dmc60c.STATUS_GENERAL))

    def test_a_lonely_controller_notices_that_nobody_acknowledges(self):
        self.client.close()
        self.bench.advance(300_000)
        self.bench.trace()
        self.connect()
        self.assertNotEqual(self.one().session, self.device.session)


class Foreign(BenchTest):
    """Frames for nobody here: nothing may change, and nothing may be answered."""

    NODES = ("dmc60c:5",)

    def assertNothingHappens(self, frame: Frame):
        trace = self.exchange(frame, us=1_500)
        status = (dmc60c.STATUS_GENERAL, dmc60c.STATUS_ENCODER, dmc60c.STATUS_ANALOG)
        self.assertEqual([seen for seen in trace if seen.from_node and seen.base not in status],
                         [], frame)
        self.assertEqual(self.duty(), 0, frame)

    def test_eleven_bit_frames(self):
        device = self.one()
        data = device.control(dmc60c.VOLTAGE, DUTY).data
        for identifier in (0x000, 0x005, 0x045, 0x240, 0x7FF):
            self.assertNothingHappens(Frame(identifier, data, ext=False))

    def test_remote_frames(self):
        device = self.one()
        for base in (dmc60c.CONTROL_0, dmc60c.PARAM_REQUEST, dmc60c.PARAM_SET,
                     dmc60c.VENDOR_COMMAND, dmc60c.VENDOR_DATA_OUT, dmc60c.STATUS_GENERAL):
            for dlc in (0, 3, 7, 8):
                self.assertNothingHappens(Frame(base | device.number, rtr=True, dlc=dlc))

    def test_other_manufacturers_types_numbers_and_interfaces(self):
        device = self.one()
        data = device.control(dmc60c.VOLTAGE, DUTY).data
        for identifier in (dmc60c.CONTROL_0, dmc60c.CONTROL_0 | 4, dmc60c.CONTROL_0 | 0x3F,
                           0x02050005, 0x02070005, 0x01060005, 0x03060005, 0x02040005,
                           0x12060005, 0x02060045, 0x02060105, 0x0206F805):
            self.assertNothingHappens(Frame(identifier, data))

    def test_its_own_kinds_of_frames_sent_by_another(self):
        device = self.one()
        for base in (dmc60c.STATUS_GENERAL, dmc60c.STATUS_ENCODER, dmc60c.STATUS_ANALOG,
                     dmc60c.PARAM_RESPONSE, dmc60c.VENDOR_STATUS, dmc60c.VENDOR_DATA_IN,
                     dmc60c.ENUM_RESPONSE):
            self.assertNothingHappens(Frame(base | device.number, b"\x12\x34\x56\x78\x9a\xbc\xde\xf0"))

    def test_two_thousand_random_frames(self):
        device = self.one()
        # The bench is deterministic, so a fixed seed gives the same frames each time. Control
        # and enumeration frames of this controller are left out: those it has to obey.
        noise = random.Random(60)
        before = {parameter: device.get(parameter) for parameter in (1, 10, 17, 61, 91, 92, 93)}
        bases = (dmc60c.PARAM_SET, dmc60c.PARAM_REQUEST, dmc60c.VENDOR_COMMAND,
                 dmc60c.VENDOR_DATA_OUT)
        for _ in range(100):
            for _ in range(20):
                data = noise.randbytes(noise.randrange(9))
                if data[:2] == device.session.to_bytes(2, "little"):
                    continue
                base = noise.choice(bases) if noise.random() < 0.5 else 0x02060000 | (
                    noise.randrange(1, 1024) << 6)
                self.send(Frame(base | device.number, data))
            self.step(5_000)
            self.assertEqual(self.duty(), 0)
        self.step(50_000)
        self.assertEqual(self.one().session, device.session)
        for parameter, value in before.items():
            self.assertEqual(device.get(parameter), value)


if __name__ == "__main__":
    unittest.main()
