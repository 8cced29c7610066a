"""Control frames: the open-loop modes, the voltage ramp, reversal, brake and coast."""

import unittest

import dmc60c
from dmc60c import Frame
from windlass_bench import BenchTest


class Voltage(BenchTest):
    def test_duty_is_the_sixteen_low_bits_of_the_target(self):
        device = self.one()
        for duty in (1, 16_384, 32_767, -1, -16_384, -32_768, 0):
            with self.subTest(duty=duty):
                status = device.general(device.run(dmc60c.VOLTAGE, duty, 20_000))
                self.assertEqual(status.duty, duty)
                self.assertEqual(self.duty(), duty)

    def test_the_high_byte_of_the_target_is_ignored(self):
        device = self.one()
        for target, duty in ((0xFF1000, 0x1000), (0x7F1000, 0x1000), (0x00F000, -0x1000),
                             (0x008000, -32_768)):
            with self.subTest(target=hex(target)):
                status = device.general(device.run(dmc60c.VOLTAGE, target, 20_000))
                self.assertEqual(status.duty, duty)

    def test_target_bytes_are_high_low_middle(self):
        device = self.one()
        frame = Frame(dmc60c.CONTROL_0, bytes([0, 0, 0, 0x00, 0x34, 0x12, 0, 0]))
        self.assertEqual(device.general(device.drive(frame, 20_000)).duty, 0x1234)

    def test_without_a_ramp_the_output_follows_at_the_next_tick(self):
        device = self.one()
        self.send(device.control(dmc60c.VOLTAGE, 20_000))
        self.step(200)  # the frame needs some 130 µs on the wire
        self.step(dmc60c.TICK_US)
        self.assertEqual(self.duty(), 20_000)

    def test_the_motor_turns_forward_for_a_positive_duty(self):
        device = self.one()
        device.run(dmc60c.VOLTAGE, 10_000, 500_000)
        self.assertGreater(self.bench.node()["velocity_counts_per_100ms"], 1_000)
        device.run(dmc60c.VOLTAGE, -10_000, 1_000_000)
        self.assertLess(self.bench.node()["velocity_counts_per_100ms"], -1_000)


class VoltageRamp(BenchTest):
    def duties(self, ticks: int) -> list:
        found = []
        for _ in range(ticks):
            self.bench.advance(dmc60c.TICK_US)
            found.append(self.duty())
        return found

    def distinct(self, values: list) -> list:
        return [value for at, value in enumerate(values) if at == 0 or values[at - 1] != value]

    def test_the_example_of_the_guide(self):
        device = self.one()
        device.run(dmc60c.VOLTAGE, 5_000, 20_000)
        self.send(device.control(dmc60c.VOLTAGE, 10_000, ramp=2_500))
        self.assertEqual(self.distinct([5_000] + self.duties(8)), [5_000, 7_500, 10_000])

    def test_every_tick_moves_by_the_rate_and_never_past_the_target(self):
        device = self.one()
        self.send(device.control(dmc60c.VOLTAGE, 1_000, ramp=300))
        self.assertEqual(self.distinct([0] + self.duties(10)), [0, 300, 600, 900, 1_000])
        self.send(device.control(dmc60c.VOLTAGE, -500, ramp=700))
        self.assertEqual(self.distinct([1_000] + self.duties(10)), [1_000, 300, -400, -500])

    def test_rate_16_takes_about_1_02_seconds_from_zero_to_full(self):
        device = self.one()
        device.set(dmc60c.GENERAL_PERIOD, 1)
        trace = device.run(dmc60c.VOLTAGE, 32_767, 1_100_000, ramp=16)
        start = next(seen.t_us for seen in trace if not seen.from_node)
        full = next(seen.t_us for seen in self.pick(trace, dmc60c.STATUS_GENERAL)
                    if dmc60c.General(seen.data).duty == 32_767)
        self.assertNear(full - start, 1_024_000, 3_000)

    def test_the_ramp_starts_from_zero_after_a_halt(self):
        device = self.one()
        device.run(dmc60c.VOLTAGE, 20_000, 50_000)
        self.step(300_000)
        self.assertEqual(self.duty(), 0)
        self.send(device.control(dmc60c.VOLTAGE, 20_000, ramp=100))
        values = self.distinct([0] + self.duties(10))
        self.assertEqual(values[:4], [0, 100, 200, 300])

    def test_largest_rate_is_sixteen_bits_unsigned(self):
        device = self.one()
        device.run(dmc60c.VOLTAGE, -32_768, 20_000)
        self.send(device.control(dmc60c.VOLTAGE, 32_767, ramp=65_535))
        self.assertEqual(self.distinct([-32_768] + self.duties(5)), [-32_768, 32_767])


class NoDrive(BenchTest):
    def test_output_is_off_at_once(self):
        device = self.one()
        device.run(dmc60c.VOLTAGE, 20_000, 100_000)
        self.send(device.control(dmc60c.NO_DRIVE, 20_000, ramp=1))
        self.step(200)
        self.step(dmc60c.TICK_US)
        self.assertEqual(self.duty(), 0)

    def test_reserved_modes_act_as_no_drive(self):
        device = self.one()
        for mode in range(6, 15):
            with self.subTest(mode=mode):
                device.run(dmc60c.VOLTAGE, 9_000, 20_000)
                self.assertEqual(self.duty(), 9_000)
                device.run(mode, 9_000, 20_000)
                self.assertEqual(self.duty(), 0)


class Reversal(BenchTest):
    def test_reversed_motor_turns_the_other_way(self):
        device = self.one()
        trace = device.run(dmc60c.VOLTAGE, 8_000, 300_000, reverse_motor=True)
        self.assertEqual(self.duty(), -8_000)
        self.assertEqual(device.general(trace).duty, -8_000)
        self.assertLess(self.bench.node()["velocity_counts_per_100ms"], 0)

    def test_full_reverse_reversed_saturates(self):
        device = self.one()
        device.run(dmc60c.VOLTAGE, -32_768, 20_000, reverse_motor=True)
        self.assertEqual(self.duty(), 32_767)

    def test_reversal_ends_with_the_next_frame_without_it(self):
        device = self.one()
        device.run(dmc60c.VOLTAGE, 8_000, 20_000, reverse_motor=True)
        device.run(dmc60c.VOLTAGE, 8_000, 20_000)
        self.assertEqual(self.duty(), 8_000)


class BrakeAndCoast(BenchTest):
    def neutral(self) -> str:
        return self.bench.node()["neutral"]

    def test_override_and_its_end(self):
        device = self.one()
        device.run(dmc60c.VOLTAGE, 0, 20_000)
        stored = self.neutral()
        self.assertEqual(stored, "brake", "default of the stored setting")
        device.run(dmc60c.VOLTAGE, 0, 20_000, brake=False)
        self.assertEqual(self.neutral(), "coast")
        device.run(dmc60c.VOLTAGE, 0, 20_000, brake=True)
        self.assertEqual(self.neutral(), "brake")
        device.run(dmc60c.VOLTAGE, 0, 20_000, brake=False)
        device.run(dmc60c.VOLTAGE, 0, 20_000)
        self.assertEqual(self.neutral(), stored)

    def test_the_button_changes_the_stored_setting(self):
        device = self.one()
        self.step(16_000_000)
        self.bench.poke(0, press_button=True)
        self.step(20_000)
        self.assertEqual(self.neutral(), "coast")
        device.run(dmc60c.VOLTAGE, 0, 20_000, brake=True)
        self.assertEqual(self.neutral(), "brake", "the control frame wins while it lasts")
        device.run(dmc60c.VOLTAGE, 0, 20_000)
        self.assertEqual(self.neutral(), "coast")
        self.bench.power_cycle(0)
        self.step(500_000)
        self.assertEqual(self.neutral(), "coast", "kept without power")
        self.bench.poke(0, press_button=True)
        self.step(20_000)
        self.assertEqual(self.neutral(), "brake")

    def test_silence_clears_the_override(self):
        device = self.one()
        device.run(dmc60c.VOLTAGE, 5_000, 20_000, brake=False)
        self.step(200_000)
        self.assertEqual(self.neutral(), "brake")

    def test_braking_stops_the_motor_sooner(self):
        device = self.one()
        speeds = {}
        for brake in (True, False):
            device.run(dmc60c.VOLTAGE, 15_000, 1_000_000)
            device.run(dmc60c.VOLTAGE, 0, 100_000, brake=brake)
            speeds[brake] = self.bench.node()["velocity_counts_per_100ms"]
        self.assertLess(abs(speeds[True]), abs(speeds[False]) / 2)


class Slots(BenchTest):
    def test_the_slot_of_the_frame_is_used(self):
        device = self.one()
        device.configure({dmc60c.F_GAIN: dmc60c.fixed(1),
                          dmc60c.F_GAIN + dmc60c.SLOT_1: dmc60c.fixed(2)})
        for slot, duty in ((0, 3_000), (1, 6_000), (0, 3_000)):
            self.send(device.control(dmc60c.VELOCITY, 3_000, slot=slot))
            self.step(200)
            self.step(dmc60c.TICK_US)
            self.assertEqual(self.duty(), duty)


class Length(BenchTest):
    def test_a_control_frame_has_exactly_eight_bytes(self):
        device = self.one()
        whole = device.control(dmc60c.VOLTAGE, 5_000).data
        for length in range(8):
            self.exchange(Frame(dmc60c.CONTROL_0, whole[:length]), us=2_000)
            self.assertEqual(self.duty(), 0, length)
        self.exchange(Frame(dmc60c.CONTROL_0, whole), us=2_000)
        self.assertEqual(self.duty(), 5_000)

    def test_reserved_bits_do_not_matter(self):
        device = self.one()
        frame = device.control(dmc60c.VOLTAGE, 5_000)
        data = bytearray(frame.data)
        data[1] |= 0xF0
        data[2] = 0xFF
        device.drive(Frame(frame.id, bytes(data)), 20_000)
        self.assertEqual(self.duty(), 5_000)


if __name__ == "__main__":
    unittest.main()
