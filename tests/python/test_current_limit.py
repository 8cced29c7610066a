"""Current limiting: when it begins, what it holds, when it ends, and what it leaves alone."""

import unittest

import dmc60c
from dmc60c import fixed
from windlass_bench import BenchTest

STALLED_50_A = 12_000  # duty that drives some 50 A through the held motor of 92 milliohms


class CurrentLimitTest(BenchTest):
    def setUp(self):
        super().setUp()
        self.device = self.one()
        self.bench.poke(0, stall=True)
        self.device.set(dmc60c.GENERAL_PERIOD, 1)

    def limits(self, continuous: float, peak: float, duration_ms: int, enabled: int = 1):
        self.device.configure({dmc60c.CONTINUOUS_LIMIT: fixed(continuous),
                               dmc60c.PEAK_LIMIT: fixed(peak),
                               dmc60c.PEAK_DURATION: duration_ms,
                               dmc60c.CURRENT_LIMIT_ENABLE: enabled})

    def first_limited(self, trace):
        """Time from the first control frame to the first status with the limit active, in µs."""
        start = next(seen.t_us for seen in trace if not seen.from_node)
        for seen in self.pick(trace, dmc60c.STATUS_GENERAL):
            if dmc60c.General(seen.data).current_limit_active:
                return seen.t_us - start
        return None

    def current(self) -> float:
        return self.bench.node()["current_a"]


class Begin(CurrentLimitTest):
    def test_after_the_peak_duration(self):
        for duration in (100, 500):
            with self.subTest(duration=duration):
                self.limits(20, 30, duration)
                trace = self.device.run(dmc60c.VOLTAGE, STALLED_50_A, 800_000)
                self.assertNear(self.first_limited(trace), duration * 1_000, 15_000)
                self.device.run(dmc60c.NO_DRIVE, 0, 200_000)

    def test_duration_zero_begins_at_the_first_sample_above_the_peak(self):
        self.limits(20, 30, 0)
        trace = self.device.run(dmc60c.VOLTAGE, STALLED_50_A, 100_000)
        self.assertLess(self.first_limited(trace), 10_000)

    def test_continuous_not_below_peak_begins_at_once_above_continuous(self):
        for peak in (25, 10):
            with self.subTest(peak=peak):
                self.limits(25, peak, 500)
                trace = self.device.run(dmc60c.VOLTAGE, STALLED_50_A, 100_000)
                self.assertLess(self.first_limited(trace), 10_000)
                self.device.run(dmc60c.NO_DRIVE, 0, 200_000)

    def test_between_continuous_and_peak_nothing_happens(self):
        self.limits(10, 60, 100)
        trace = self.device.run(dmc60c.VOLTAGE, 8_000, 1_500_000)
        self.assertIsNone(self.first_limited(trace))
        self.assertGreater(self.current(), 15)
        self.assertEqual(self.duty(), 8_000)

    def test_interrupted_peaks_do_not_add_up(self):
        self.limits(20, 30, 300)
        for _ in range(4):
            trace = self.device.run(dmc60c.VOLTAGE, STALLED_50_A, 200_000)
            trace += self.device.run(dmc60c.VOLTAGE, 2_000, 100_000)
            self.assertIsNone(self.first_limited(trace))

    def test_disabled_means_no_limit(self):
        self.limits(5, 10, 0, enabled=0)
        trace = self.device.run(dmc60c.VOLTAGE, STALLED_50_A, 500_000)
        self.assertIsNone(self.first_limited(trace))
        self.assertEqual(self.duty(), STALLED_50_A)
        self.assertGreater(self.current(), 30)


class Hold(CurrentLimitTest):
    def test_a_stalled_motor_is_held_at_the_continuous_limit(self):
        for continuous, sign in ((20, 1), (35, 1), (20, -1)):
            with self.subTest(continuous=continuous, sign=sign):
                self.limits(continuous, continuous + 10, 200)
                self.device.run(dmc60c.VOLTAGE, sign * STALLED_50_A, 1_000_000)
                for _ in range(10):
                    self.device.run(dmc60c.VOLTAGE, sign * STALLED_50_A, 100_000)
                    self.assertNear(self.current(), sign * continuous, continuous * 0.05)
                self.device.run(dmc60c.NO_DRIVE, 0, 300_000)

    def test_the_defaults_hold_forty_amps(self):
        self.device.set(dmc60c.CURRENT_LIMIT_ENABLE, 1)
        self.device.set(dmc60c.PEAK_LIMIT, fixed(50))
        self.device.run(dmc60c.VOLTAGE, 15_000, 1_500_000)
        for _ in range(10):
            self.device.run(dmc60c.VOLTAGE, 15_000, 100_000)
            self.assertNear(self.current(), 40, 2)

    def test_the_limit_never_raises_the_output(self):
        self.limits(20, 30, 100)
        self.device.run(dmc60c.VOLTAGE, STALLED_50_A, 500_000)
        self.device.run(dmc60c.VOLTAGE, 1_000, 50_000)
        self.assertEqual(self.duty(), 1_000)


class End(CurrentLimitTest):
    def test_ends_when_the_request_stays_below_the_cap(self):
        self.limits(20, 30, 100)
        trace = self.device.run(dmc60c.VOLTAGE, STALLED_50_A, 500_000)
        self.assertTrue(self.device.general(trace).current_limit_active)
        trace = self.device.run(dmc60c.VOLTAGE, 1_000, 50_000)
        self.assertFalse(self.device.general(trace).current_limit_active)
        trace = self.device.run(dmc60c.VOLTAGE, STALLED_50_A, 400_000)
        self.assertNear(self.first_limited(trace), 100_000, 15_000, "the peak timer starts anew")

    def test_ends_with_the_output(self):
        self.limits(20, 30, 100)
        self.device.run(dmc60c.VOLTAGE, STALLED_50_A, 500_000)
        trace = self.device.run(dmc60c.NO_DRIVE, 0, 20_000)
        self.assertFalse(self.device.general(trace).current_limit_active)


if __name__ == "__main__":
    unittest.main()
