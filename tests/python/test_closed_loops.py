"""The closed loops on the plant: a CIM-class motor with a 1024-cycle encoder at 12 V."""

import unittest

import dmc60c
from dmc60c import fixed
from windlass_bench import BenchTest

SLOT_1 = dmc60c.SLOT_1

# The gains of docs/tuning.md: velocity in slot 0, position in slot 1.
VELOCITY_GAINS = {dmc60c.F_GAIN: fixed(0.86), dmc60c.P_GAIN: fixed(0.25),
                  dmc60c.I_GAIN: fixed(0.003), dmc60c.I_ZONE: 200_000, dmc60c.RAMP_RATE: 200}
POSITION_GAINS = {dmc60c.P_GAIN + SLOT_1: fixed(2), dmc60c.D_GAIN + SLOT_1: fixed(130),
                  dmc60c.ALLOWABLE_ERROR + SLOT_1: 2, dmc60c.RAMP_RATE + SLOT_1: 400,
                  dmc60c.FWD_NOMINAL + SLOT_1: 600, dmc60c.REV_NOMINAL + SLOT_1: -600,
                  dmc60c.FWD_MAX + SLOT_1: 12_000, dmc60c.REV_MAX + SLOT_1: -12_000}
CURRENT_GAINS = {dmc60c.P_GAIN: fixed(20), dmc60c.I_GAIN: fixed(10)}


class Velocity(BenchTest):
    def settled(self, target: int) -> int:
        """The time after which the velocity stays within 3 % of the target, in µs."""
        start = self.bench.now
        last_outside = start
        for _ in range(120):
            if self.bench.now % 50_000 == start % 50_000:
                self.send(self.device.control(dmc60c.VELOCITY, target))
            self.step(10_000)
            velocity = self.bench.node()["velocity_counts_per_100ms"]
            if abs(velocity - target) > abs(target) * 0.03:
                last_outside = self.bench.now
        return last_outside - start

    def test_steps_settle_within_three_percent_in_half_a_second(self):
        self.device = self.one()
        self.device.configure(VELOCITY_GAINS)
        for target in (15_000, -15_000, 5_000, 25_000):
            with self.subTest(target=target):
                self.assertLess(self.settled(target), 500_000)

    def test_reversed_motor_with_reversed_sensor_closes_the_same_loop(self):
        self.device = self.one()
        self.device.configure(VELOCITY_GAINS)
        trace = self.device.run(dmc60c.VELOCITY, 12_000, 1_500_000, reverse_motor=True,
                                reverse_sensor=True)
        self.assertNear(self.device.encoder(trace).velocity, 12_000, 360)
        self.assertNear(self.bench.node()["velocity_counts_per_100ms"], -12_000, 360)

    def test_error_of_the_status_is_target_minus_velocity(self):
        self.device = self.one()
        self.device.configure(VELOCITY_GAINS)
        trace = self.device.run(dmc60c.VELOCITY, 12_000, 1_500_000)
        self.assertNear(self.device.general(trace).error, 0, 360)


class Position(BenchTest):
    def test_moves_end_within_two_counts(self):
        device = self.one()
        device.configure(POSITION_GAINS)
        for target in (4_096, -20_000, -19_900, 0):
            with self.subTest(target=target):
                device.run(dmc60c.POSITION, target, 1_500_000, slot=1)
                trace = device.run(dmc60c.POSITION, target, 300_000, slot=1)
                self.assertNear(self.bench.node()["position_counts"], target, 2)
                self.assertNear(device.encoder(trace).position, target, 2)
                self.assertNear(device.general(trace).error, 0, 2)


class Current(BenchTest):
    def test_current_of_a_held_motor_stays_within_five_percent(self):
        device = self.one()
        self.bench.poke(0, stall=True)
        device.configure(CURRENT_GAINS)
        for target in (10, 30, -20):
            with self.subTest(target=target):
                device.run(dmc60c.CURRENT, fixed(target), 500_000)
                for _ in range(10):
                    trace = device.run(dmc60c.CURRENT, fixed(target), 100_000)
                    self.assertNear(self.bench.node()["current_a"], target, abs(target) * 0.05)
                self.assertNear(device.analog(trace).current, target, abs(target) * 0.05)

    def test_current_holds_while_the_battery_sags(self):
        device = self.one()
        self.bench.poke(0, stall=True)
        device.configure(CURRENT_GAINS)
        device.run(dmc60c.CURRENT, fixed(25), 500_000)
        for volts in (11.0, 9.0, 14.0):
            self.bench.poke(0, battery_v=volts)
            device.run(dmc60c.CURRENT, fixed(25), 300_000)
            self.assertNear(self.bench.node()["current_a"], 25, 1.25)


if __name__ == "__main__":
    unittest.main()
