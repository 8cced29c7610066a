"""Periodic status frames: their periods in virtual time, and every field against the truth."""

import unittest

import dmc60c
from windlass_bench import BenchTest

PERIODS = {  # message: parameter, default, shortest and longest period in milliseconds
    dmc60c.STATUS_GENERAL: (dmc60c.GENERAL_PERIOD, 10, 1, 50),
    dmc60c.STATUS_ENCODER: (dmc60c.ENCODER_PERIOD, 100, 1, 30_000),
    dmc60c.STATUS_ANALOG: (dmc60c.ANALOG_PERIOD, 100, 1, 30_000),
}


class Periods(BenchTest):
    def assertPeriod(self, trace, base, period_ms, tolerance_us=dmc60c.TICK_US):
        times = [seen.t_us for seen in self.pick(trace, base)]
        self.assertGreaterEqual(len(times), 3)
        for earlier, later in zip(times, times[1:]):
            self.assertNear(later - earlier, period_ms * 1000, tolerance_us, hex(base))

    def test_defaults(self):
        self.wake()
        trace = self.step(1_050_000)
        for base, (_, default, *_) in PERIODS.items():
            self.assertPeriod(trace, base, default)

    def test_python_can_sees_every_status_frame(self):
        self.wake()
        trace = self.exchange(us=1_000_000)  # compares python-can's messages with the trace
        self.assertNear(len(self.pick(trace, dmc60c.STATUS_GENERAL)), 100, 1)
        self.assertNear(len(self.pick(trace, dmc60c.STATUS_ENCODER)), 10, 1)
        self.assertNear(len(self.pick(trace, dmc60c.STATUS_ANALOG)), 10, 1)

    def test_periods_stay_exact_over_a_minute(self):
        self.wake()
        self.step(1_000_000)
        trace = self.step(60_000_000)
        times = [seen.t_us for seen in self.pick(trace, dmc60c.STATUS_GENERAL)]
        self.assertNear(times[-1] - times[0], (len(times) - 1) * 10_000, dmc60c.TICK_US)
        self.assertNear(len(times), 6_000, 1)

    def test_set_periods(self):
        device = self.one()
        for base, (parameter, _, shortest, longest) in PERIODS.items():
            for period in (shortest, 7, 25, min(longest, 333)):
                with self.subTest(base=hex(base), period=period):
                    device.set(parameter, period)
                    self.step(2_000 + 1_000 * period)
                    trace = self.step(max(10_000, 4 * 1_000 * period + 1_000))
                    self.assertPeriod(trace, base, period)
            device.set(parameter, longest)

    def test_longest_period(self):
        device = self.one()
        device.set(dmc60c.ENCODER_PERIOD, 30_000)
        self.step(31_000_000)
        trace = self.step(90_500_000)
        self.assertPeriod(trace, dmc60c.STATUS_ENCODER, 30_000)

    def test_first_analog_frame_comes_a_whole_period_after_the_start(self):
        trace = self.exchange(dmc60c.enumerate_request(), us=400_000)
        first = self.pick(trace, dmc60c.STATUS_ANALOG)[0]
        self.assertNear(first.t_us, trace[0].t_us + 100_000, 1_500)

    def test_frames_carry_the_device_number_and_eight_bytes(self):
        device = self.one()
        device.command(dmc60c.SET_DEVICE_NUMBER, 33)
        trace = self.step(250_000)
        for base in PERIODS:
            frames = self.pick(trace, base, 33)
            self.assertTrue(frames)
            self.assertEqual({seen.dlc for seen in frames}, {8})


class GeneralFields(BenchTest):
    def test_at_rest(self):
        device = self.one()
        status = device.status()
        self.assertEqual(status.duty, 0)
        # Normally open switches with pull-ups: pins high, not hit, enabled.
        self.assertTrue(status.fwd_pin and status.rev_pin)
        for name in ("fwd_hit", "fwd_disabled", "fwd_normally_closed", "rev_hit", "rev_disabled",
                     "rev_normally_closed", "limit_override", "fwd_disable_override",
                     "rev_disable_override", "soft_fwd_hit", "soft_fwd_enabled", "soft_rev_hit",
                     "soft_rev_enabled", "current_limit_active", "over_temperature",
                     "under_voltage", "gate_driver", "error_divided"):
            self.assertFalse(getattr(status, name), name)
        self.assertEqual(status.error_raw, 0)

    def test_mode_is_the_one_that_was_selected(self):
        device = self.one()
        for mode in (0, 1, 2, 3, 4, 15):
            with self.subTest(mode=mode):
                self.assertEqual(device.general(device.run(mode, 0, 30_000)).mode, mode)

    def test_switch_configuration_is_reported(self):
        device = self.one()
        for parameter, name in ((1, "fwd_normally_closed"), (2, "fwd_disabled"),
                                (3, "rev_normally_closed"), (4, "rev_disabled"),
                                (6, "soft_fwd_enabled"), (8, "soft_rev_enabled")):
            with self.subTest(name=name):
                device.set(parameter, 1)
                self.assertTrue(getattr(device.status(), name))
                device.set(parameter, 0)
                self.assertFalse(getattr(device.status(), name))

    def test_override_bits_are_those_of_the_control_frame(self):
        device = self.one()
        for override in (False, True):
            for fwd in (False, True):
                for rev in (False, True):
                    trace = device.run(dmc60c.VOLTAGE, 0, 30_000, limit_override=override,
                                       disable_fwd_limit=fwd, disable_rev_limit=rev)
                    status = device.general(trace)
                    self.assertEqual((status.limit_override, status.fwd_disable_override,
                                      status.rev_disable_override), (override, fwd, rev))

    def test_error_is_zero_in_follower_and_no_drive(self):
        device = self.one()
        device.set(dmc60c.ENCODER_POSITION, 1_000)
        trace = device.run(dmc60c.POSITION, 5_000, 30_000)
        self.assertEqual(device.general(trace).error, 4_000)
        trace = device.drive(dmc60c.follow(0, 1), 30_000)
        self.assertEqual(device.general(trace).error, 0)
        trace = device.run(dmc60c.NO_DRIVE, 0, 30_000)
        self.assertEqual(device.general(trace).error, 0)

    def test_position_error_is_divided_by_256_beyond_24_bits(self):
        device = self.one()
        for target, position, wanted, divided in (
                (8_388_607, 0, 8_388_607, False),
                (8_388_607, -1, 8_388_608 >> 8, True),
                (-8_388_608, 0, -8_388_608, False),
                (-8_388_608, 1, -8_388_609 >> 8, True)):
            with self.subTest(target=target, position=position):
                device.set(dmc60c.ENCODER_POSITION, position)
                status = device.general(device.run(dmc60c.POSITION, target, 30_000))
                self.assertEqual((status.error_raw, status.error_divided), (wanted, divided))

    def test_velocity_error_is_a_count(self):
        device = self.one()
        self.bench.poke(0, stall=True)
        status = device.general(device.run(dmc60c.VELOCITY, -1_234, 30_000))
        self.assertEqual((status.error_raw, status.error_divided), (-1_234, False))

    def test_current_error_is_8_16_amps(self):
        device = self.one()
        status = device.general(device.run(dmc60c.CURRENT, dmc60c.fixed(12.5), 30_000))
        self.assertNear(status.error / 65536, 12.5, 0.2)


class EncoderFields(BenchTest):
    def at(self, device, position: int) -> dmc60c.Encoder:
        device.set(dmc60c.ENCODER_POSITION, position)
        return device.encoder(self.step(110_000))

    def test_position_and_its_divide_flag_at_the_limits(self):
        device = self.one()
        for position, raw, divided in (
                (0, 0, False), (1, 1, False), (-1, -1, False),
                (0x123456, 0x123456, False),
                (8_388_607, 8_388_607, False), (8_388_608, 1_048_576, True),
                (-8_388_608, -8_388_608, False), (-8_388_609, -1_048_577, True),
                (67_108_863, 8_388_607, True), (-67_108_864, -8_388_608, True)):
            with self.subTest(position=position):
                encoder = self.at(device, position)
                self.assertEqual((encoder.position_raw, encoder.position_divided), (raw, divided))

    def test_position_beyond_the_field_saturates(self):
        device = self.one()
        for position, raw in ((0x7FFFFFFF, 8_388_607), (-0x80000000, -8_388_608)):
            encoder = self.at(device, position)
            self.assertEqual((encoder.position_raw, encoder.position_divided), (raw, True))

    def test_high_byte_comes_first(self):
        device = self.one()
        device.set(dmc60c.ENCODER_POSITION, 0x0A0B0C)
        frame = self.last(self.step(110_000), dmc60c.STATUS_ENCODER)
        self.assertEqual(frame.data[:3], b"\x0a\x0b\x0c")

    def test_position_and_velocity_agree_with_the_plant(self):
        device = self.one()
        for duty in (12_000, -12_000):
            device.run(dmc60c.VOLTAGE, duty, 2_000_000)
            encoder = device.encoder(device.run(dmc60c.VOLTAGE, duty, 100_000))
            truth = self.bench.node()
            self.assertNear(encoder.velocity, truth["velocity_counts_per_100ms"],
                            abs(truth["velocity_counts_per_100ms"]) * 0.01 + 2)
            self.assertEqual(encoder.velocity > 0, duty > 0)
            self.assertEqual(encoder.reserved, b"\0\0")

    def test_velocity_is_the_change_of_the_position_in_100_ms(self):
        device = self.one()
        device.run(dmc60c.VOLTAGE, 10_000, 2_000_000)
        frames = [dmc60c.Encoder(seen.data) for seen in self.pick(
            device.run(dmc60c.VOLTAGE, 10_000, 1_000_000), dmc60c.STATUS_ENCODER)]
        self.assertGreaterEqual(len(frames), 9)
        for earlier, later in zip(frames, frames[1:]):
            self.assertNear(later.position - earlier.position, later.velocity,
                            later.velocity * 0.005 + 2)

    def test_velocity_divide_flag_above_sixteen_bits(self):
        device = self.one()
        self.bench.poke(0, battery_v=15.0)  # free speed of the default motor: some 45 000 counts
        seen_divided = seen_whole = False
        for seen in self.pick(device.run(dmc60c.VOLTAGE, 32_767, 3_000_000, ramp=16),
                              dmc60c.STATUS_ENCODER):
            encoder = dmc60c.Encoder(seen.data)
            if encoder.velocity_divided:
                seen_divided = True
                self.assertGreater(encoder.velocity, 32_764)
            else:
                seen_whole = True
                self.assertLessEqual(encoder.velocity, 32_767)
        self.assertTrue(seen_divided and seen_whole)
        truth = self.bench.node()["velocity_counts_per_100ms"]
        self.assertNear(encoder.velocity, truth, truth * 0.01)

    def test_pins_of_the_encoder(self):
        device = self.one()
        for level in (False, True):
            self.bench.poke(0, index_pin=level)
            self.assertEqual(device.encoder(self.step(110_000)).pin_index, level)
        pins = set()
        device.set(dmc60c.ENCODER_PERIOD, 1)
        for seen in self.pick(device.run(dmc60c.VOLTAGE, 3_000, 500_000), dmc60c.STATUS_ENCODER):
            encoder = dmc60c.Encoder(seen.data)
            pins.add((encoder.pin_a, encoder.pin_b))
        self.assertEqual(len(pins), 4, "both channels take every combination while turning")


class AnalogFields(BenchTest):
    def test_analog_input(self):
        device = self.one()
        for volts in (0.0, 1.0, 2.5, 3.29):
            self.bench.poke(0, analog_v=volts)
            analog = device.analog(self.step(210_000))
            self.assertNear(analog.ain1, volts, 0.01)

    def test_bus_voltage_and_temperature(self):
        device = self.one()
        for volts in (8.0, 12.0, 24.0):
            self.bench.poke(0, battery_v=volts)
            analog = device.analog(self.step(210_000))
            self.assertNear(analog.bus, self.bench.node()["bus_v"], 0.05)
            self.assertNear(analog.bus, volts, 0.3)
        for celsius in (20.0, 60.0):
            self.bench.poke(0, temp_c=celsius)
            analog = device.analog(self.step(210_000))
            self.assertNear(analog.temperature, self.bench.node()["temp_c"], 1.0)

    def test_current_is_zero_at_rest_and_signed_under_load(self):
        device = self.one()
        self.assertNear(device.analog(self.step(210_000)).current, 0, 0.1)
        self.bench.poke(0, stall=True)
        for duty in (6_000, -6_000):
            analog = device.analog(device.run(dmc60c.VOLTAGE, duty, 300_000))
            truth = self.bench.node()["current_a"]
            self.assertNear(analog.current, truth, 0.3)
            self.assertEqual(analog.current > 10, duty > 0)
            self.assertEqual(analog.current < -10, duty < 0)

    def test_the_multiplier_scales_the_current(self):
        device = self.one()
        self.bench.poke(0, stall=True)
        currents = {}
        for multiplier in (0x816, 0x840, 0x816 // 2):
            device.set(dmc60c.ADC_CURRENT_MULTIPLIER, multiplier)
            analog = device.analog(device.run(dmc60c.VOLTAGE, 8_000, 300_000))
            currents[multiplier] = analog.current
        self.assertNear(currents[0x840] / currents[0x816], 0x840 / 0x816, 0.004)
        self.assertNear(currents[0x816 // 2] / currents[0x816], 0.5, 0.004)

    def test_a_saturated_conversion_reads_the_end_of_the_range(self):
        # 2047 steps of 0x816 / 65536 A: the range is some 64.7 A to either side.
        device = self.one()
        self.bench.poke(0, stall=True)
        for duty, end in ((26_000, 64.66), (-26_000, -64.69)):
            analog = device.analog(device.run(dmc60c.VOLTAGE, duty, 300_000))
            self.assertGreater(abs(self.bench.node()["current_a"]), 66)
            self.assertNear(analog.current, end, 0.2)
            device.run(dmc60c.NO_DRIVE, 0, 100_000)

    def test_multiplier_of_the_formula(self):
        # (3.3 / 4096) / (0.0005 * 50) * 65536 = 2112 = 0x840 for a shunt of 500 microohms
        self.assertEqual(round(3.3 / 4096 / (0.0005 * 50) * 65536), 0x840)
        # The bench's shunt is the one that the default 0x816 belongs to: readings are true.
        device = self.one()
        self.assertEqual(device.get(dmc60c.ADC_CURRENT_MULTIPLIER), 0x816)
        self.bench.poke(0, stall=True)
        analog = device.analog(device.run(dmc60c.VOLTAGE, 10_000, 300_000))
        truth = self.bench.node()["current_a"]
        self.assertGreater(truth, 20)
        self.assertNear(analog.current / truth, 1.0, 0.01)


if __name__ == "__main__":
    unittest.main()
