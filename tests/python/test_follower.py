"""Follower mode: one controller repeats the output of another from its general status."""

import unittest

import dmc60c
from windlass_bench import BenchTest

MASTER, SLAVE = 4, 9


class FollowerTest(BenchTest):
    NODES = (f"dmc60c:{MASTER}", f"dmc60c:{SLAVE}")

    def setUp(self):
        super().setUp()
        found = {device.number: device for device in self.enumerate()}
        self.master, self.slave = found[MASTER], found[SLAVE]

    def drive_both(self, duty: int, us: int, **options):
        """The master gets a duty, the slave is told to follow, every 50 ms."""
        left, trace = us, []
        while left > 0:
            span = min(50_000, left)
            self.send(self.master.control(dmc60c.VOLTAGE, duty),
                      dmc60c.follow(SLAVE, MASTER, **options))
            trace += self.step(span)
            left -= span
        return trace


class Following(FollowerTest):
    def test_the_slave_tracks_within_one_status_period(self):
        self.drive_both(5_000, 100_000)
        for duty in (9_000, -12_345, 32_767, -32_768, 1, 0):
            with self.subTest(duty=duty):
                self.drive_both(duty, 1_000)
                self.assertEqual(self.duty(0), duty)
                self.step(10_000 + dmc60c.TICK_US)
                self.assertEqual(self.duty(1), duty)

    def test_a_ramping_master_is_never_further_ahead_than_one_period(self):
        self.drive_both(0, 50_000)
        ramp = 20
        worst = 0
        for _ in range(20):
            self.send(self.master.control(dmc60c.VOLTAGE, 20_000, ramp=ramp),
                      dmc60c.follow(SLAVE, MASTER))
            for _ in range(10):
                self.step(5_000)
                worst = max(worst, abs(self.duty(0) - self.duty(1)))
        self.assertLessEqual(worst, ramp * 22, "10 ms are 20 ticks of the ramp")

    def test_the_status_names_the_mode_and_no_error(self):
        trace = self.drive_both(6_000, 100_000)
        status = self.slave.general(trace)
        self.assertEqual((status.mode, status.duty, status.error), (dmc60c.FOLLOWER, 6_000, 0))

    def test_the_slave_may_be_reversed(self):
        self.drive_both(6_000, 100_000, reverse_motor=True)
        self.assertEqual(self.duty(1), -6_000)

    def test_the_ramp_of_the_slave_counts(self):
        self.drive_both(6_000, 40_000, ramp=10)
        self.assertGreater(self.duty(1), 0)
        self.assertLess(self.duty(1), 1_000)

    def test_reversed_sensor_is_ignored(self):
        trace = self.drive_both(6_000, 500_000, reverse_sensor=True)
        self.assertGreater(self.slave.encoder(trace).velocity, 0)

    def test_limits_of_the_slave_stop_only_the_slave(self):
        self.bench.poke(1, fwd_limit_closed=True)
        self.drive_both(6_000, 100_000)
        self.assertEqual((self.duty(0), self.duty(1)), (6_000, 0))


class Timeouts(FollowerTest):
    def test_silent_master_means_zero_and_the_slave_stays_a_follower(self):
        self.drive_both(6_000, 100_000)
        self.bench.poke(0, powered=False)
        for _ in range(2):  # the last status is at most 10 ms old: 104 ms are not over yet
            self.send(dmc60c.follow(SLAVE, MASTER))
            self.step(45_000)
        self.assertEqual(self.duty(1), 6_000)
        self.send(dmc60c.follow(SLAVE, MASTER))
        trace = self.step(20_000)
        self.assertEqual(self.duty(1), 0)
        self.assertEqual(self.slave.general(trace).mode, dmc60c.FOLLOWER)
        self.bench.poke(0, powered=True)
        self.step(80_000)
        self.drive_both(5_000, 100_000)
        self.assertEqual(self.duty(1), 5_000)

    def test_the_slave_needs_its_own_control_frames(self):
        self.drive_both(6_000, 100_000)
        for _ in range(4):
            self.send(self.master.control(dmc60c.VOLTAGE, 6_000))
            self.step(50_000)
        self.assertEqual((self.duty(0), self.duty(1)), (6_000, 0))

    def test_only_whole_status_frames_of_the_master_count(self):
        other = 33
        for frame, wanted in (
                (dmc60c.Frame(dmc60c.STATUS_GENERAL | other, b"\x10\x27" + bytes(5)), 0),
                (dmc60c.Frame(dmc60c.STATUS_GENERAL | other + 1, b"\x10\x27" + bytes(6)), 0),
                (dmc60c.Frame(dmc60c.STATUS_GENERAL | other, b"\x10\x27" + bytes(6)), 10_000)):
            with self.subTest(frame=frame):
                self.send(dmc60c.follow(SLAVE, other), frame)
                self.step(5_000)
                self.assertEqual(self.duty(1), wanted)


if __name__ == "__main__":
    unittest.main()
