"""The encoder: setting and clearing the position, the index pin, reversal of the sensor."""

import unittest

import dmc60c
from windlass_bench import BenchTest


class EncoderTest(BenchTest):
    def setUp(self):
        super().setUp()
        self.device = self.one()

    def position(self) -> int:
        return self.device.get(dmc60c.ENCODER_POSITION)


class Setting(EncoderTest):
    def test_zero_at_power_on(self):
        self.assertEqual(self.position(), 0)
        self.device.set(dmc60c.ENCODER_POSITION, 777)
        self.bench.power_cycle(0)
        self.step(500_000)
        self.device = self.one()
        self.assertEqual(self.position(), 0)

    def test_any_position_can_be_set(self):
        for position in (1, -1, 0x7FFFFFFF, -0x80000000):
            self.device.set(dmc60c.ENCODER_POSITION, position)
            self.assertEqual(self.position(), position)

    def test_setting_the_position_is_no_movement(self):
        self.device.set(dmc60c.ENCODER_PERIOD, 5)
        self.device.set(dmc60c.ENCODER_POSITION, 30_000)
        for seen in self.pick(self.step(200_000), dmc60c.STATUS_ENCODER):
            self.assertEqual(dmc60c.Encoder(seen.data).velocity, 0)

    def test_counts_go_on_from_the_position_that_was_set(self):
        self.device.set(dmc60c.ENCODER_POSITION, 100_000)
        before = self.bench.node()["position_counts"]
        self.device.run(dmc60c.VOLTAGE, 5_000, 500_000)
        self.device.run(dmc60c.VOLTAGE, 0, 1_000_000)
        moved = self.bench.node()["position_counts"] - before
        self.assertGreater(abs(moved), 1_000)
        self.assertNear(self.position() - 100_000, moved, 2)

    def test_position_wraps_at_32_bits(self):
        self.device.set(dmc60c.ENCODER_POSITION, 0x7FFFFFFF - 100)
        self.device.run(dmc60c.VOLTAGE, 5_000, 500_000)
        self.assertLess(self.position(), -0x7FF00000)

    def test_unplugged_encoder_counts_nothing(self):
        self.bench.poke(0, encoder_unplugged=True)
        before = self.position()
        self.device.run(dmc60c.VOLTAGE, 5_000, 500_000)
        self.assertEqual(self.position(), before)


class Index(EncoderTest):
    def edge(self, level: bool):
        self.bench.poke(0, index_pin=level)
        self.step(2_000)

    def test_falling_edge_clears_by_default(self):
        self.edge(True)
        self.device.set(dmc60c.CLEAR_ON_INDEX, 1)
        self.device.set(dmc60c.ENCODER_POSITION, 500)
        self.edge(False)
        self.assertEqual(self.position(), 0)
        self.device.set(dmc60c.ENCODER_POSITION, 500)
        self.edge(True)
        self.assertEqual(self.position(), 500, "the other edge does nothing")

    def test_rising_edge_when_chosen(self):
        self.edge(False)
        self.device.configure({dmc60c.CLEAR_ON_INDEX: 1, dmc60c.INDEX_ACTIVE_EDGE: 1})
        self.device.set(dmc60c.ENCODER_POSITION, 500)
        self.edge(True)
        self.assertEqual(self.position(), 0)
        self.device.set(dmc60c.ENCODER_POSITION, 500)
        self.edge(False)
        self.assertEqual(self.position(), 500)

    def test_ignored_unless_enabled(self):
        self.device.set(dmc60c.ENCODER_POSITION, 500)
        for level in (True, False, True):
            self.edge(level)
        self.assertEqual(self.position(), 500)


class ClearByLimit(EncoderTest):
    def test_cleared_for_as_long_as_the_switch_is_active(self):
        for pin, parameter in (("fwd_limit_closed", dmc60c.CLEAR_ON_FWD_LIMIT),
                               ("rev_limit_closed", dmc60c.CLEAR_ON_REV_LIMIT)):
            with self.subTest(pin=pin):
                self.device.set(parameter, 1)
                self.device.set(dmc60c.ENCODER_POSITION, 900)
                self.assertEqual(self.position(), 900)
                self.bench.poke(0, **{pin: True})
                self.step(2_000)
                self.assertEqual(self.position(), 0)
                self.device.put(dmc60c.ENCODER_POSITION, 900)
                self.step(2_000)
                self.assertEqual(self.position(), 0, "still active, still cleared")
                self.bench.poke(0, **{pin: False})
                self.step(2_000)
                self.device.set(dmc60c.ENCODER_POSITION, 900)
                self.assertEqual(self.position(), 900)
                self.device.set(parameter, 0)

    def test_the_switch_need_not_be_enabled(self):
        self.device.configure({dmc60c.FWD_DISABLED: 1, dmc60c.CLEAR_ON_FWD_LIMIT: 1})
        self.device.set(dmc60c.ENCODER_POSITION, 900)
        self.bench.poke(0, fwd_limit_closed=True)
        self.step(2_000)
        self.assertEqual(self.position(), 0)

    def test_the_active_state_follows_the_type_of_the_switch(self):
        self.bench.poke(0, rev_limit_closed=True)
        self.device.configure({dmc60c.REV_NORMALLY_CLOSED: 1, dmc60c.CLEAR_ON_REV_LIMIT: 1})
        self.device.set(dmc60c.ENCODER_POSITION, 900)
        self.assertEqual(self.position(), 900)
        self.bench.poke(0, rev_limit_closed=False)
        self.step(2_000)
        self.assertEqual(self.position(), 0)


class SensorReversal(EncoderTest):
    def moved(self, frame) -> tuple:
        before = self.position()
        trace = self.device.drive(frame, 500_000)
        velocity = self.device.encoder(trace).velocity
        return self.position() - before, velocity

    def test_counts_turn_round(self):
        forward = self.moved(self.device.control(dmc60c.VOLTAGE, 5_000))
        self.assertTrue(forward[0] > 500 and forward[1] > 500, forward)
        backward = self.moved(
            self.device.control(dmc60c.VOLTAGE, 5_000, reverse_sensor=True))
        self.assertTrue(backward[0] < -500 and backward[1] < -500, backward)


if __name__ == "__main__":
    unittest.main()
