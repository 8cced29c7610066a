"""Configuration parameters: defaults, access, ranges, storage and the errors of each."""

import unittest

import dmc60c
from dmc60c import Frame
from windlass_bench import BenchTest

I32_MIN, I32_MAX = -0x80000000, 0x7FFFFFFF
U31 = (0, I32_MAX)
I32 = (I32_MIN, I32_MAX)
FLAG = (0, 1)


def slot(offset: int) -> dict:
    """The eleven parameters of a motor control slot: default, lowest and highest value."""
    return {
        dmc60c.P_GAIN + offset: (0, *I32), dmc60c.I_GAIN + offset: (0, *I32),
        dmc60c.D_GAIN + offset: (0, *I32), dmc60c.I_ZONE + offset: (0, *U31),
        dmc60c.F_GAIN + offset: (0, *I32), dmc60c.ALLOWABLE_ERROR + offset: (0, *U31),
        dmc60c.RAMP_RATE + offset: (0, *U31), dmc60c.FWD_MAX + offset: (32767, 0, 32767),
        dmc60c.REV_MAX + offset: (-32768, -32768, 0),
        dmc60c.FWD_NOMINAL + offset: (0, 0, 32767),
        dmc60c.REV_NOMINAL + offset: (0, -32768, 0),
    }


# Parameters that are kept over a power cycle: default, lowest, highest.
STORED = {
    1: (0, *FLAG), 2: (0, *FLAG), 3: (0, *FLAG), 4: (0, *FLAG),
    5: (0, *I32), 6: (0, *FLAG), 7: (0, *I32), 8: (0, *FLAG), 9: (0x816, *I32),
    **slot(0), **slot(dmc60c.SLOT_1),
    32: (0x00640000, *I32), 33: (0x003C0000, *I32), 34: (0, *I32), 35: (0x014CC888, *U31),
    36: (0, *I32),
    61: (40 << 16, 0, I32_MAX), 62: (60 << 16, 0, I32_MAX), 63: (500, 0, 65535), 64: (0, *FLAG),
}
# Parameters that start with their default at each power-on.
VOLATILE = {
    41: (0, *I32), 42: (0, *FLAG), 43: (0, *FLAG), 44: (0, *FLAG), 45: (0, *FLAG),
    91: (100, 1, 30000), 92: (100, 1, 30000), 93: (10, 1, 50),
}
FAULT_INFORMATION = {51: 0, 52: 0, 53: 0, 54: 0, 55: 0, 56: 0, 57: 0}
UNKNOWN = (0, 37, 38, 39, 40, 46, 47, 48, 49, 50, 58, 59, 60, 65, 80, 90, 94, 100, 127, 255)


class Table(BenchTest):
    def test_defaults(self):
        device = self.one()
        for parameter, (default, *_) in (STORED | VOLATILE).items():
            with self.subTest(parameter=parameter):
                self.assertEqual(device.get(parameter), default)
        for parameter, default in FAULT_INFORMATION.items():
            with self.subTest(parameter=parameter):
                self.assertEqual(device.get(parameter), default)

    def test_both_ends_of_each_range_are_accepted_and_kept(self):
        device = self.one()
        for parameter, (default, lowest, highest) in (STORED | VOLATILE).items():
            for value in (lowest, highest, default):
                with self.subTest(parameter=parameter, value=value):
                    device.set(parameter, value)
                    self.assertEqual(device.get(parameter), value)

    def test_values_outside_are_refused_and_change_nothing(self):
        device = self.one()
        for parameter, (default, lowest, highest) in (STORED | VOLATILE).items():
            outside = [value for value in (lowest - 1, highest + 1)
                       if I32_MIN <= value <= 0xFFFFFFFF and (lowest, highest) != I32]
            if parameter in (61, 62):
                outside = []  # whether a negative limit is refused is not said anywhere
            for value in outside:
                with self.subTest(parameter=parameter, value=value):
                    response = device.put(parameter, value)
                    self.assertEqual((response.error, response.value),
                                     (dmc60c.PARAM_BAD_VALUE, 0))
                    self.assertEqual(device.get(parameter), default)

    def test_unknown_parameters(self):
        device = self.one()
        for parameter in UNKNOWN:
            with self.subTest(parameter=parameter):
                wanted = (parameter, 0, dmc60c.PARAM_BAD_PARAMETER)
                self.assertEqual(device.request(parameter), wanted)
                self.assertEqual(device.put(parameter, 1), wanted)

    def test_active_faults_can_only_be_read(self):
        device = self.one()
        self.assertEqual(device.put(dmc60c.ACTIVE_FAULTS, 0x1F),
                         (dmc60c.ACTIVE_FAULTS, 0, dmc60c.PARAM_NO_ERROR))
        self.assertEqual(device.get(dmc60c.ACTIVE_FAULTS), 0)

    def test_reading_with_set_zero_changes_no_fault_information(self):
        device = self.one()
        for parameter in range(52, 58):
            self.assertEqual(device.put(parameter, 0), (parameter, 0, dmc60c.PARAM_NO_ERROR))


class Storage(BenchTest):
    def changed(self, table: dict) -> dict:
        """For each parameter an accepted value that is not its default."""
        return {parameter: (highest if highest != default else lowest)
                for parameter, (default, lowest, highest) in table.items()}

    def test_what_is_saved_survives_the_power_and_the_rest_does_not(self):
        device = self.one()
        stored, volatile = self.changed(STORED), self.changed(VOLATILE)
        device.configure(stored)
        device.configure(volatile)
        self.step(20_000_000)
        self.bench.power_cycle(0)
        self.step(1_000_000)
        device = self.one()
        for parameter, value in stored.items():
            with self.subTest(parameter=parameter):
                self.assertEqual(device.get(parameter), value)
        for parameter, (default, *_) in VOLATILE.items():
            with self.subTest(parameter=parameter):
                self.assertEqual(device.get(parameter), default)

    def writes(self) -> int:
        return self.bench.node()["flash_writes"]

    def test_first_change_is_written_at_once_and_later_ones_after_fifteen_quiet_seconds(self):
        device = self.one()
        self.step(16_000_000)
        before = self.writes()
        device.set(dmc60c.P_GAIN, 1)
        self.step(10_000)
        once = self.writes()
        self.assertGreater(once, before, "nothing was changed for 15 s: written immediately")

        device.set(dmc60c.P_GAIN, 2)
        self.step(10_000_000)
        device.set(dmc60c.P_GAIN, 3)
        self.step(14_500_000)
        self.assertEqual(self.writes(), once, "changed again less than 15 s ago")
        self.step(1_000_000)
        self.assertGreater(self.writes(), once)
        self.bench.power_cycle(0)
        self.step(1_000_000)
        self.assertEqual(self.one().get(dmc60c.P_GAIN), 3)

    def test_a_change_that_was_not_written_is_lost_with_the_power(self):
        device = self.one()
        self.step(16_000_000)
        device.set(dmc60c.P_GAIN, 11)
        self.step(10_000)
        device.set(dmc60c.P_GAIN, 12)
        self.step(1_000_000)
        self.bench.power_cycle(0)
        self.step(1_000_000)
        self.assertEqual(self.one().get(dmc60c.P_GAIN), 11)


class Frames(BenchTest):
    def test_short_frames_are_ignored(self):
        device = self.one()
        whole_set = dmc60c.param_set(0, device.session, dmc60c.P_GAIN, 5).data
        whole_request = dmc60c.param_request(0, device.session, dmc60c.P_GAIN).data
        for length in range(7):
            trace = self.exchange(Frame(dmc60c.PARAM_SET, whole_set[:length]), us=2_000)
            self.assertEqual(self.pick(trace, dmc60c.PARAM_RESPONSE), [], length)
        for length in range(3):
            trace = self.exchange(Frame(dmc60c.PARAM_REQUEST, whole_request[:length]), us=2_000)
            self.assertEqual(self.pick(trace, dmc60c.PARAM_RESPONSE), [], length)
        self.assertEqual(device.get(dmc60c.P_GAIN), 0)

    def test_answers_carry_the_device_number_and_no_session(self):
        device = self.one()
        trace = self.exchange(dmc60c.param_set(0, device.session, dmc60c.D_GAIN, 0x01020304))
        (answer,) = self.pick(trace, dmc60c.PARAM_RESPONSE)
        self.assertEqual(answer.id, dmc60c.PARAM_RESPONSE)
        self.assertEqual(answer.data, bytes([dmc60c.D_GAIN, 4, 3, 2, 1, 0]))

    def test_each_of_many_requests_sent_together_is_answered_in_order(self):
        device = self.one()
        wanted = list(range(10, 21))
        trace = self.exchange(*(dmc60c.param_request(0, device.session, parameter)
                                for parameter in wanted), us=20_000)
        answers = [dmc60c.param_response(seen.data).parameter
                   for seen in self.pick(trace, dmc60c.PARAM_RESPONSE)]
        self.assertEqual(answers, wanted)


if __name__ == "__main__":
    unittest.main()
