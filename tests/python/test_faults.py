"""Faults: detection, the three-second timer, sticky bits, counts and what they do to the output."""

import unittest

import dmc60c
from dmc60c import fixed
from windlass_bench import BenchTest

DUTY = 6_000


class FaultTest(BenchTest):
    def setUp(self):
        super().setUp()
        self.device = self.one()

    def faults(self) -> tuple:
        """Active and sticky faults."""
        return self.device.get(dmc60c.ACTIVE_FAULTS), self.device.get(dmc60c.STICKY_FAULTS)

    def drive(self, us: int, duty: int = DUTY) -> dmc60c.General:
        return self.device.general(self.device.run(dmc60c.VOLTAGE, duty, us))

    def time_until_output(self, limit_us: int, duty: int = DUTY) -> int:
        """How long the drive has to go on until the output comes back, in steps of 10 ms."""
        start = self.bench.now
        while self.bench.now - start < limit_us:
            self.device.run(dmc60c.VOLTAGE, duty, 10_000)
            if self.duty() != 0:
                return self.bench.now - start
        self.fail(f"no output within {limit_us} µs")


class GateDriver(FaultTest):
    def test_output_goes_off_in_the_same_tick(self):
        self.drive(50_000)
        self.assertEqual(self.duty(), DUTY)
        self.bench.poke(0, gate_driver_fault=True)
        self.step(dmc60c.TICK_US)
        self.assertEqual(self.duty(), 0)

    def test_reported_everywhere(self):
        self.bench.poke(0, gate_driver_fault=True)
        status = self.drive(50_000)
        self.assertEqual(status.duty, 0)
        self.assertTrue(status.gate_driver)
        self.assertFalse(status.under_voltage or status.over_temperature)
        self.assertEqual(self.faults(), (dmc60c.FAULT_GATE_DRIVER, dmc60c.FAULT_GATE_DRIVER))
        self.assertEqual(self.device.get(dmc60c.COUNT_GATE_DRIVER), 1)

    def test_output_comes_back_three_seconds_after_the_fault_has_gone(self):
        self.bench.poke(0, gate_driver_fault=True)
        self.drive(1_000_000)
        self.bench.poke(0, gate_driver_fault=False)
        self.assertNear(self.time_until_output(4_000_000), 3_000_000, 20_000)
        active, sticky = self.faults()
        self.assertEqual((active, sticky), (0, dmc60c.FAULT_GATE_DRIVER))

    def test_a_fault_that_stays_keeps_the_output_off(self):
        self.bench.poke(0, gate_driver_fault=True)
        self.drive(7_000_000)
        self.assertEqual(self.duty(), 0)
        self.assertEqual(self.device.get(dmc60c.COUNT_GATE_DRIVER), 1, "one fault, not many")

    def test_another_fault_restarts_the_timer(self):
        self.bench.poke(0, gate_driver_fault=True)
        self.drive(20_000)
        self.bench.poke(0, gate_driver_fault=False)
        self.drive(2_000_000)
        self.bench.poke(0, gate_driver_fault=True)
        self.drive(20_000)
        self.bench.poke(0, gate_driver_fault=False)
        self.assertNear(self.time_until_output(4_000_000), 3_000_000, 20_000)

    def test_short_circuit_is_a_gate_driver_fault(self):
        self.drive(20_000)
        self.bench.poke(0, short_circuit=True)
        self.drive(50_000)
        self.assertEqual(self.duty(), 0)
        self.assertTrue(self.faults()[1] & dmc60c.FAULT_GATE_DRIVER)


class UnderVoltage(FaultTest):
    def test_after_five_seconds_below_5_75_volts(self):
        self.bench.poke(0, battery_v=5.70)
        self.drive(4_950_000, duty=500)
        self.assertEqual(self.faults(), (0, 0))
        self.assertEqual(self.duty(), 500)
        status = self.drive(100_000, duty=500)
        self.assertEqual(status.duty, 0)
        self.assertTrue(status.under_voltage)
        self.assertEqual(self.faults(), (dmc60c.FAULT_UNDER_VOLTAGE, dmc60c.FAULT_UNDER_VOLTAGE))
        self.assertEqual(self.device.get(dmc60c.COUNT_UNDER_VOLTAGE), 1)

    def test_not_above_5_75_volts(self):
        self.bench.poke(0, battery_v=5.80)
        self.step(8_000_000)
        self.assertEqual(self.faults(), (0, 0))

    def test_seconds_must_be_consecutive(self):
        for _ in range(3):
            self.bench.poke(0, battery_v=5.5)
            self.step(4_000_000)
            self.bench.poke(0, battery_v=6.0)
            self.step(10_000)
        self.assertEqual(self.faults(), (0, 0))

    def test_recovery_takes_three_seconds_from_the_last_low_sample(self):
        self.bench.poke(0, battery_v=5.5)
        self.step(7_000_000)
        self.bench.poke(0, battery_v=12.0)
        self.assertNear(self.time_until_output(4_000_000), 3_000_000, 20_000)


class OverTemperature(FaultTest):
    def test_at_105_degrees(self):
        self.bench.poke(0, temp_c=104.0)
        self.assertEqual(self.faults(), (0, 0))
        self.bench.poke(0, temp_c=106.0)
        status = self.drive(20_000)
        self.assertEqual(status.duty, 0)
        self.assertTrue(status.over_temperature)
        self.assertEqual(self.faults()[1], dmc60c.FAULT_OVER_TEMPERATURE)
        self.assertEqual(self.device.get(dmc60c.COUNT_OVER_TEMPERATURE), 1)

    def test_duty_is_derated_between_85_and_105_degrees(self):
        for celsius, share in ((84, 1.0), (90, 0.75), (95, 0.5), (100, 0.25)):
            with self.subTest(celsius=celsius):
                self.bench.poke(0, temp_c=float(celsius))
                status = self.drive(20_000, duty=32_767)
                self.assertEqual(status.duty, self.duty())
                self.assertNear(status.duty / 32_767, share, 0.03)


class OverCurrent(FaultTest):
    def fault_after(self, duty: int, limit_us: int) -> int:
        start = self.bench.now
        while self.bench.now - start < limit_us:
            self.device.run(dmc60c.VOLTAGE, duty, 50_000)
            if self.duty() == 0:
                return self.bench.now - start
        self.fail(f"no fault within {limit_us} µs")

    def test_a_saturated_conversion_for_one_second(self):
        self.bench.poke(0, stall=True)
        for duty in (26_000, -26_000):
            with self.subTest(duty=duty):
                self.assertNear(self.fault_after(duty, 3_000_000), 1_000_000, 60_000)
                self.assertEqual(self.faults()[1] & dmc60c.FAULT_OVER_CURRENT,
                                 dmc60c.FAULT_OVER_CURRENT)
                self.step(4_000_000)
        self.assertEqual(self.device.get(dmc60c.COUNT_OVER_CURRENT), 2)

    def test_62_amps_for_four_seconds(self):
        self.bench.poke(0, stall=True)
        self.device.configure({dmc60c.P_GAIN: fixed(10), dmc60c.I_GAIN: fixed(5)})
        self.device.run(dmc60c.CURRENT, fixed(61.0), 5_000_000)
        self.assertNear(self.bench.node()["current_a"], 61.0, 0.8)
        self.assertEqual(self.faults(), (0, 0))
        start = self.bench.now
        while self.duty() != 0 and self.bench.now - start < 6_000_000:
            self.device.run(dmc60c.CURRENT, fixed(63.3), 50_000)
        self.assertNear(self.bench.now - start, 4_000_000, 100_000)
        self.assertEqual(self.faults()[1], dmc60c.FAULT_OVER_CURRENT)


class Sticky(FaultTest):
    def setUp(self):
        super().setUp()
        self.bench.poke(0, gate_driver_fault=True)
        self.step(20_000)
        self.bench.poke(0, gate_driver_fault=False)
        self.step(4_000_000)

    def test_reading_with_zero_clears_nothing(self):
        for _ in range(2):
            answer = self.device.put(dmc60c.STICKY_FAULTS, 0)
            self.assertEqual((answer.value, answer.error), (dmc60c.FAULT_GATE_DRIVER, 0))

    def test_clearing_returns_the_old_value_and_leaves_the_counts(self):
        answer = self.device.put(dmc60c.STICKY_FAULTS, 1)
        self.assertEqual((answer.value, answer.error), (dmc60c.FAULT_GATE_DRIVER, 0))
        self.assertEqual(self.device.get(dmc60c.STICKY_FAULTS), 0)
        self.assertEqual(self.device.get(dmc60c.COUNT_GATE_DRIVER), 1)

    def test_clearing_a_count_returns_the_old_value_and_leaves_the_bits(self):
        answer = self.device.put(dmc60c.COUNT_GATE_DRIVER, 0xFFFFFFFF)
        self.assertEqual((answer.value, answer.error), (1, 0))
        self.assertEqual(self.device.get(dmc60c.COUNT_GATE_DRIVER), 0)
        self.assertEqual(self.device.get(dmc60c.STICKY_FAULTS), dmc60c.FAULT_GATE_DRIVER)

    def test_kept_over_the_power(self):
        self.step(20_000_000)
        self.bench.power_cycle(0)
        self.step(500_000)
        self.device = self.one()
        self.assertEqual(self.faults(), (0, dmc60c.FAULT_GATE_DRIVER))
        self.assertEqual(self.device.get(dmc60c.COUNT_GATE_DRIVER), 1)


class Communication(FaultTest):
    def lose_the_bus(self):
        self.bench.poke(0, bus_connected=False)
        self.step(300_000)
        self.bench.poke(0, bus_connected=True)
        self.step(100_000)
        self.device = self.one()

    def test_counted_and_sticky_but_never_active(self):
        self.assertEqual(self.device.get(dmc60c.COUNT_COMMUNICATION), 0)
        for losses in (1, 2):
            self.lose_the_bus()
            self.assertEqual(self.faults(), (0, dmc60c.FAULT_COMMUNICATION))
            self.assertEqual(self.device.get(dmc60c.COUNT_COMMUNICATION), losses)

    def test_no_three_second_timer(self):
        self.lose_the_bus()
        self.assertLess(self.time_until_output(500_000), 50_000)

    def test_the_count_starts_anew_with_the_power(self):
        self.lose_the_bus()
        self.step(20_000_000)
        self.bench.power_cycle(0)
        self.step(500_000)
        self.device = self.one()
        self.assertEqual(self.device.get(dmc60c.COUNT_COMMUNICATION), 0)


if __name__ == "__main__":
    unittest.main()
