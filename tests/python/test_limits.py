"""Limit switches and soft limits: what blocks which direction, and how it is reported."""

import unittest

import dmc60c
from windlass_bench import BenchTest

FORWARD = ("fwd_limit_closed", dmc60c.FWD_NORMALLY_CLOSED, dmc60c.FWD_DISABLED, 6_000, "fwd")
REVERSE = ("rev_limit_closed", dmc60c.REV_NORMALLY_CLOSED, dmc60c.REV_DISABLED, -6_000, "rev")


class LimitTest(BenchTest):
    def setUp(self):
        super().setUp()
        self.device = self.one()
        self.bench.poke(0, encoder_unplugged=True)

    def drive(self, duty: int, **options) -> dmc60c.General:
        status = self.device.general(self.device.run(dmc60c.VOLTAGE, duty, 20_000, **options))
        self.assertEqual(status.duty, self.duty(), "the status tells what is at the terminals")
        return status


class Switches(LimitTest):
    def test_closed_normally_open_switch_blocks_its_own_direction(self):
        for pin, _, _, duty, name in (FORWARD, REVERSE):
            with self.subTest(pin=pin):
                self.assertEqual(self.drive(duty).duty, duty)
                self.bench.poke(0, **{pin: True})
                status = self.drive(duty)
                self.assertEqual(status.duty, 0)
                self.assertFalse(getattr(status, name + "_pin"), "a closed switch pulls it low")
                self.assertTrue(getattr(status, name + "_hit"))
                self.assertEqual(self.drive(-duty).duty, -duty)
                self.bench.poke(0, **{pin: False})
                status = self.drive(duty)
                self.assertEqual(status.duty, duty)
                self.assertTrue(getattr(status, name + "_pin"))
                self.assertFalse(getattr(status, name + "_hit"))

    def test_open_normally_closed_switch_blocks_its_own_direction(self):
        for pin, normally_closed, _, duty, name in (FORWARD, REVERSE):
            with self.subTest(pin=pin):
                self.device.set(normally_closed, 1)
                status = self.drive(duty)
                self.assertEqual(status.duty, 0)
                self.assertTrue(getattr(status, name + "_pin"))
                self.assertTrue(getattr(status, name + "_hit"))
                self.assertTrue(getattr(status, name + "_normally_closed"))
                self.assertEqual(self.drive(-duty).duty, -duty)
                self.bench.poke(0, **{pin: True})
                self.assertEqual(self.drive(duty).duty, duty)
                self.device.set(normally_closed, 0)
                self.bench.poke(0, **{pin: False})

    def test_disabled_switch_blocks_nothing_and_is_still_reported(self):
        for pin, _, disabled, duty, name in (FORWARD, REVERSE):
            with self.subTest(pin=pin):
                self.device.set(disabled, 1)
                self.bench.poke(0, **{pin: True})
                status = self.drive(duty)
                self.assertEqual(status.duty, duty)
                self.assertTrue(getattr(status, name + "_disabled"))
                self.assertTrue(getattr(status, name + "_hit"))
                self.device.set(disabled, 0)
                self.assertEqual(self.drive(duty).duty, 0)
                self.bench.poke(0, **{pin: False})

    def test_control_frame_disables_an_enabled_switch(self):
        self.bench.poke(0, fwd_limit_closed=True, rev_limit_closed=True)
        for fwd in (False, True):
            for rev in (False, True):
                options = {"limit_override": True, "disable_fwd_limit": fwd,
                           "disable_rev_limit": rev}
                self.assertEqual(self.drive(6_000, **options).duty, 6_000 if fwd else 0)
                self.assertEqual(self.drive(-6_000, **options).duty, -6_000 if rev else 0)

    def test_control_frame_enables_a_disabled_switch(self):
        self.device.configure({dmc60c.FWD_DISABLED: 1, dmc60c.REV_DISABLED: 1})
        self.bench.poke(0, fwd_limit_closed=True, rev_limit_closed=True)
        self.assertEqual(self.drive(6_000).duty, 6_000)
        self.assertEqual(self.drive(6_000, limit_override=True).duty, 0)
        self.assertEqual(self.drive(-6_000, limit_override=True).duty, 0)

    def test_disable_bits_alone_do_nothing(self):
        self.bench.poke(0, fwd_limit_closed=True)
        self.assertEqual(self.drive(6_000, disable_fwd_limit=True, disable_rev_limit=True).duty, 0)

    def test_limits_act_on_the_direction_at_the_terminals(self):
        self.bench.poke(0, fwd_limit_closed=True)
        self.assertEqual(self.drive(6_000, reverse_motor=True).duty, -6_000)
        self.assertEqual(self.drive(-6_000, reverse_motor=True).duty, 0)

    def test_a_switch_acts_within_a_tick(self):
        self.drive(6_000)
        self.bench.poke(0, fwd_limit_closed=True)
        self.step(dmc60c.TICK_US)
        self.assertEqual(self.duty(), 0)

    def test_limits_act_in_closed_loop_too(self):
        self.device.set(dmc60c.F_GAIN, dmc60c.fixed(1))
        self.bench.poke(0, fwd_limit_closed=True)
        self.device.run(dmc60c.VELOCITY, 5_000, 20_000)
        self.assertEqual(self.duty(), 0)
        self.device.run(dmc60c.VELOCITY, -5_000, 20_000)
        self.assertEqual(self.duty(), -5_000)


class SoftLimits(LimitTest):
    """With the encoder unplugged the position stays where it is put."""

    def at(self, position: int, duty: int, **options) -> dmc60c.General:
        self.device.set(dmc60c.ENCODER_POSITION, position)
        return self.drive(duty, **options)

    def test_forward_acts_from_its_threshold_on(self):
        for threshold in (1_000, 0, -1_000, 0x7FFFFFFF, -0x7FFFFFFF):
            with self.subTest(threshold=threshold):
                self.device.configure({dmc60c.SOFT_FWD_THRESHOLD: threshold,
                                       dmc60c.SOFT_FWD_ENABLE: 1})
                below = self.at(threshold - 1, 6_000)
                self.assertEqual((below.duty, below.soft_fwd_hit), (6_000, False))
                equal = self.at(threshold, 6_000)
                self.assertEqual((equal.duty, equal.soft_fwd_hit), (0, True))
                self.assertEqual(self.drive(-6_000).duty, -6_000)
        above = self.at(5_000, 6_000)
        self.assertEqual((above.duty, above.soft_fwd_hit), (0, True))

    def test_reverse_acts_from_its_threshold_down(self):
        for threshold in (1_000, 0, -1_000, -0x80000000, 0x7FFFFFFE):
            with self.subTest(threshold=threshold):
                self.device.configure({dmc60c.SOFT_REV_THRESHOLD: threshold,
                                       dmc60c.SOFT_REV_ENABLE: 1})
                above = self.at(threshold + 1, -6_000)
                self.assertEqual((above.duty, above.soft_rev_hit), (-6_000, False))
                equal = self.at(threshold, -6_000)
                self.assertEqual((equal.duty, equal.soft_rev_hit), (0, True))
                self.assertEqual(self.drive(6_000).duty, 6_000)

    def test_disabled_limits_block_nothing(self):
        self.device.configure({dmc60c.SOFT_FWD_THRESHOLD: -10, dmc60c.SOFT_REV_THRESHOLD: 10})
        self.assertEqual(self.at(0, 6_000).duty, 6_000)
        self.assertEqual(self.at(0, -6_000).duty, -6_000)

    def test_override_of_the_switches_leaves_the_soft_limits(self):
        self.device.configure({dmc60c.SOFT_FWD_THRESHOLD: 0, dmc60c.SOFT_FWD_ENABLE: 1})
        status = self.at(0, 6_000, limit_override=True, disable_fwd_limit=True,
                         disable_rev_limit=True)
        self.assertEqual(status.duty, 0)

    def test_a_moving_motor_is_stopped_at_the_threshold(self):
        self.bench.poke(0, encoder_unplugged=False)
        self.device.configure({dmc60c.SOFT_FWD_THRESHOLD: 20_000, dmc60c.SOFT_FWD_ENABLE: 1})
        self.device.run(dmc60c.VOLTAGE, 6_000, 3_000_000)
        truth = self.bench.node()
        self.assertGreaterEqual(truth["position_counts"], 20_000)
        self.assertEqual(truth["duty"], 0)
        self.assertNear(truth["velocity_counts_per_100ms"], 0, 20)


if __name__ == "__main__":
    unittest.main()
