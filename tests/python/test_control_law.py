"""The PIDF law, term by term, with the shaft held so that the error is known exactly."""

import unittest

import dmc60c
from dmc60c import fixed
from windlass_bench import BenchTest


class Law(BenchTest):
    """Velocity mode with the encoder unplugged: the measured velocity is 0, the error is the
    target, and every term can be calculated."""

    def setUp(self):
        super().setUp()
        self.device = self.one()
        self.bench.poke(0, encoder_unplugged=True)

    def output(self, target: int, us: int = 20_000, **options) -> int:
        return self.device.general(self.device.run(dmc60c.VELOCITY, target, us, **options)).duty


class Terms(Law):
    def test_without_gains_there_is_no_output(self):
        self.assertEqual(self.output(30_000), 0)

    def test_proportional(self):
        for gain, target, wanted in ((1, 1_000, 1_000), (2.5, 400, 1_000), (-1, 700, -700),
                                     (0.5, -3_000, -1_500)):
            with self.subTest(gain=gain, target=target):
                self.device.set(dmc60c.P_GAIN, fixed(gain))
                self.assertEqual(self.output(target), wanted)

    def test_feed_forward_multiplies_the_setpoint(self):
        self.device.set(dmc60c.F_GAIN, fixed(0.25))
        self.assertEqual(self.output(8_000), 2_000)
        self.assertEqual(self.output(-8_000), -2_000)

    def test_integral_sums_the_error_every_tick(self):
        self.device.set(dmc60c.I_GAIN, fixed(0.01))
        self.send(self.device.control(dmc60c.VELOCITY, 1_000))
        self.step(1_000)
        values = []
        for _ in range(20):
            self.bench.advance(dmc60c.TICK_US)
            values.append(self.duty())
        self.assertEqual({later - earlier for earlier, later in zip(values, values[1:])}, {10})

    def test_integral_zone_clamps_the_accumulator_on_both_sides(self):
        self.device.configure({dmc60c.I_GAIN: fixed(1), dmc60c.I_ZONE: 5_000})
        self.assertEqual(self.output(1_000, us=50_000), 5_000)
        self.assertEqual(self.output(-1_000, us=50_000), -5_000)

    def test_integral_zone_zero_means_no_clamp(self):
        self.device.configure({dmc60c.I_GAIN: fixed(1), dmc60c.I_ZONE: 0})
        self.assertEqual(self.output(1_000, us=50_000), 32_767)

    def test_derivative_acts_on_a_change_of_the_error(self):
        self.device.configure({dmc60c.D_GAIN: fixed(1)})
        self.output(1)  # the law runs from the first setpoint on; from there the error changes
        self.send(self.device.control(dmc60c.VELOCITY, 4_001))
        peaks = []
        for _ in range(6):
            self.bench.advance(dmc60c.TICK_US)
            peaks.append(self.duty())
        self.assertIn(4_000, peaks)
        self.assertEqual(peaks[-1], 0)

    def test_terms_add_up_and_saturate(self):
        self.device.configure({dmc60c.P_GAIN: fixed(1), dmc60c.F_GAIN: fixed(2)})
        self.assertEqual(self.output(3_000), 9_000)
        self.assertEqual(self.output(20_000), 32_767)
        self.assertEqual(self.output(-20_000), -32_768)
        self.device.configure({dmc60c.P_GAIN: 0x7FFFFFFF, dmc60c.F_GAIN: 0x7FFFFFFF})
        self.assertEqual(self.output(8_388_607), 32_767)
        self.assertEqual(self.output(-8_388_608), -32_768)


class AllowableError(Law):
    def setUp(self):
        super().setUp()
        self.device.configure({dmc60c.P_GAIN: fixed(10), dmc60c.F_GAIN: fixed(1)})

    def test_below_it_only_feed_forward_is_left(self):
        self.device.set(dmc60c.ALLOWABLE_ERROR, 101)
        self.assertEqual(self.output(100), 100)
        self.assertEqual(self.output(-100), -100)

    def test_above_it_every_term_counts(self):
        self.device.set(dmc60c.ALLOWABLE_ERROR, 99)
        self.assertEqual(self.output(100), 1_100)
        self.assertEqual(self.output(-100), -1_100)

    def test_zero_switches_it_off(self):
        self.device.set(dmc60c.ALLOWABLE_ERROR, 0)
        self.assertEqual(self.output(1), 11)

    def test_it_clears_the_accumulator(self):
        self.device.configure({dmc60c.P_GAIN: 0, dmc60c.F_GAIN: 0, dmc60c.I_GAIN: fixed(1),
                               dmc60c.I_ZONE: 9_000, dmc60c.ALLOWABLE_ERROR: 50})
        self.assertEqual(self.output(1_000, us=50_000), 9_000)
        self.assertEqual(self.output(10), 0)
        self.send(self.device.control(dmc60c.VELOCITY, 100))
        self.step(1_500)
        self.assertLessEqual(self.duty(), 400, "the sum starts again from zero")


class Bounds(Law):
    def test_greatest_duty(self):
        self.device.configure({dmc60c.P_GAIN: fixed(10), dmc60c.FWD_MAX: 12_000,
                               dmc60c.REV_MAX: -8_000})
        self.assertEqual(self.output(10_000), 12_000)
        self.assertEqual(self.output(-10_000), -8_000)
        self.assertEqual(self.output(100), 1_000)

    def test_smallest_duty_outside_the_allowable_error(self):
        self.device.configure({dmc60c.P_GAIN: fixed(1), dmc60c.FWD_NOMINAL: 2_000,
                               dmc60c.REV_NOMINAL: -1_500})
        self.assertEqual(self.output(100), 2_000)
        self.assertEqual(self.output(-100), -1_500)
        self.assertEqual(self.output(5_000), 5_000)
        self.assertEqual(self.output(0), 0, "no output stays no output")

    def test_smallest_duty_is_not_used_inside_the_allowable_error(self):
        self.device.configure({dmc60c.F_GAIN: fixed(1), dmc60c.FWD_NOMINAL: 2_000,
                               dmc60c.ALLOWABLE_ERROR: 200})
        self.assertEqual(self.output(100), 100)
        self.assertEqual(self.output(300), 2_000)

    def test_bounds_belong_to_the_slot(self):
        self.device.configure({dmc60c.F_GAIN: fixed(1), dmc60c.F_GAIN + dmc60c.SLOT_1: fixed(1),
                               dmc60c.FWD_MAX + dmc60c.SLOT_1: 500})
        self.assertEqual(self.output(1_000, slot=0), 1_000)
        self.assertEqual(self.output(1_000, slot=1), 500)


class ClosedLoopRamp(Law):
    def test_ramp_16_takes_about_1_02_seconds(self):
        self.device.configure({dmc60c.P_GAIN: fixed(100), dmc60c.RAMP_RATE: 16,
                               dmc60c.GENERAL_PERIOD: 1})
        trace = self.device.run(dmc60c.VELOCITY, 30_000, 1_100_000)
        start = next(seen.t_us for seen in trace if not seen.from_node)
        full = next(seen.t_us for seen in self.pick(trace, dmc60c.STATUS_GENERAL)
                    if dmc60c.General(seen.data).duty == 32_767)
        self.assertNear(full - start, 1_024_000, 3_000)

    def test_the_example_of_the_guide(self):
        self.device.configure({dmc60c.F_GAIN: fixed(1), dmc60c.RAMP_RATE: 1_000})
        self.send(self.device.control(dmc60c.VELOCITY, 5_000))
        values = [0]
        for _ in range(8):
            self.bench.advance(dmc60c.TICK_US)
            if self.duty() != values[-1]:
                values.append(self.duty())
        self.assertEqual(values, [0, 1_000, 2_000, 3_000, 4_000, 5_000])

    def test_the_ramp_of_the_frame_is_not_used_in_closed_loop(self):
        self.device.configure({dmc60c.F_GAIN: fixed(1)})
        self.send(self.device.control(dmc60c.VELOCITY, 5_000, ramp=1))
        self.step(200)
        self.step(dmc60c.TICK_US)
        self.assertEqual(self.duty(), 5_000)


class FeedForwardOfCurrent(BenchTest):
    def test_the_example_of_the_guide(self):
        """0x03332CCC is 819.175 in 16.16: 20 A gives half of the full duty."""
        device = self.one()
        device.set(dmc60c.F_GAIN, 0x03332CCC)
        status = device.general(device.run(dmc60c.CURRENT, fixed(20), 20_000))
        self.assertIn(status.duty, (16_383, 16_384))
        status = device.general(device.run(dmc60c.CURRENT, fixed(-20), 20_000))
        self.assertIn(status.duty, (-16_383, -16_384))


class SlotSwitch(Law):
    def test_parameters_act_at_the_next_tick(self):
        self.device.set(dmc60c.P_GAIN, fixed(1))
        self.assertEqual(self.output(1_000), 1_000)
        self.device.set(dmc60c.P_GAIN, fixed(2))
        self.assertEqual(self.duty(), 2_000)


if __name__ == "__main__":
    unittest.main()
