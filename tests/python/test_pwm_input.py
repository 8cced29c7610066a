"""RC pulses as input: only while no CAN bus is there."""

import unittest

import dmc60c
from windlass_bench import BenchTest


class PulseInput(BenchTest):
    CONNECT = False  # a silent client would do as well; none at all is clearer

    def pulse(self, us):
        self.bench.poke(0, pulse_width_us=us)

    def settle(self, us: int) -> float:
        """The output in percent some time after the pulses changed."""
        self.pulse(us)
        self.bench.advance(300_000)
        return self.duty() / 32_767 * 100

    def test_working_range(self):
        for width, percent in ((1_500, 0), (2_000, 100), (1_000, -100)):
            with self.subTest(width=width):
                self.assertNear(self.settle(width), percent, 0.5)

    def test_between_it_is_monotonic_and_signed(self):
        values = [self.settle(width) for width in range(1_000, 2_001, 100)]
        self.assertEqual(values, sorted(values))
        self.assertTrue(20 < self.settle(1_750) < 60)
        self.assertTrue(-60 < self.settle(1_250) < -20)

    def test_dead_band_around_the_middle(self):
        for width in (1_490, 1_510):
            self.assertEqual(self.settle(width), 0)

    def test_accepted_beyond_the_working_range_and_saturated(self):
        self.assertNear(self.settle(2_300), 100, 0.5)
        self.assertNear(self.settle(700), -100, 0.5)

    def test_pulses_outside_the_accepted_range_are_no_signal(self):
        for width in (500, 2_500):
            self.settle(1_800)
            self.assertEqual(self.settle(width), 0)

    def test_missing_pulses_end_the_drive_after_100_ms(self):
        self.assertGreater(self.settle(1_800), 10)
        self.pulse(None)
        self.bench.advance(60_000)
        self.assertGreater(self.duty(), 0)
        self.bench.advance(80_000)
        self.assertEqual(self.duty(), 0)

    def test_the_first_can_frame_takes_the_output_away(self):
        self.assertGreater(self.settle(1_800), 10)
        self.connect()
        self.wake()
        self.step(1_000)
        self.assertEqual(self.duty(), 0)
        self.step(1_000_000)
        self.assertEqual(self.duty(), 0)
        device = self.one()
        device.run(dmc60c.VOLTAGE, -3_000, 20_000)
        self.assertEqual(self.duty(), -3_000)

    def test_the_loss_of_the_bus_gives_it_back(self):
        self.settle(1_800)
        self.connect()
        self.wake()
        self.step(50_000)
        self.bench.poke(0, bus_connected=False)
        self.step(500_000)
        self.assertGreater(self.duty(), 0)


if __name__ == "__main__":
    unittest.main()
