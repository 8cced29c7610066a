"""Voltage compensation: the output voltage stays while the battery does not."""

import unittest

import dmc60c
from dmc60c import fixed
from windlass_bench import BenchTest


class VoltageCompensation(BenchTest):
    def setUp(self):
        super().setUp()
        self.device = self.one()

    def output_volts(self) -> float:
        truth = self.bench.node()
        return truth["duty"] / 32_768 * truth["bus_v"]

    def test_duty_is_target_over_bus_voltage(self):
        for volts in (1.0, 6.0, -6.0, 10.0):
            with self.subTest(volts=volts):
                self.device.run(dmc60c.VOLTAGE_COMPENSATION, fixed(volts), 1_500_000)
                self.assertNear(self.output_volts(), volts, abs(volts) * 0.02)

    def test_held_within_two_percent_while_the_battery_sags(self):
        self.device.run(dmc60c.VOLTAGE_COMPENSATION, fixed(6.0), 1_000_000)
        for tenths in range(126, 75, -3):
            self.bench.poke(0, battery_v=tenths / 10)
            self.device.run(dmc60c.VOLTAGE_COMPENSATION, fixed(6.0), 20_000)
            self.assertNear(self.output_volts(), 6.0, 0.12)

    def test_held_under_a_load_that_comes_suddenly(self):
        self.device.run(dmc60c.VOLTAGE_COMPENSATION, fixed(6.0), 1_000_000)
        before = self.bench.node()["bus_v"]
        self.bench.poke(0, load_nm=0.6)
        self.device.run(dmc60c.VOLTAGE_COMPENSATION, fixed(6.0), 500_000)
        self.assertLess(self.bench.node()["bus_v"], before, "the load pulls the battery down")
        self.assertNear(self.output_volts(), 6.0, 0.12)

    def test_more_than_the_battery_gives_full_duty(self):
        self.bench.poke(0, battery_v=11.0)
        for volts, duty in ((20.0, 32_767), (-20.0, -32_768), (127.9, 32_767), (-128.0, -32_768)):
            with self.subTest(volts=volts):
                self.device.run(dmc60c.VOLTAGE_COMPENSATION, fixed(volts), 20_000)
                self.assertEqual(self.duty(), duty)

    def test_the_ramp_of_the_frame_counts(self):
        self.device.set(dmc60c.GENERAL_PERIOD, 1)
        trace = self.device.run(dmc60c.VOLTAGE_COMPENSATION, fixed(60), 1_100_000, ramp=16)
        start = next(seen.t_us for seen in trace if not seen.from_node)
        full = next(seen.t_us for seen in self.pick(trace, dmc60c.STATUS_GENERAL)
                    if dmc60c.General(seen.data).duty == 32_767)
        self.assertNear(full - start, 1_024_000, 3_000)

    def test_the_motor_may_be_reversed(self):
        self.device.run(dmc60c.VOLTAGE_COMPENSATION, fixed(6.0), 500_000, reverse_motor=True)
        self.assertNear(self.output_volts(), -6.0, 0.12)

    def test_the_mode_is_reported(self):
        trace = self.device.run(dmc60c.VOLTAGE_COMPENSATION, fixed(3.0), 50_000)
        self.assertEqual(self.device.general(trace).mode, dmc60c.VOLTAGE_COMPENSATION)


if __name__ == "__main__":
    unittest.main()
