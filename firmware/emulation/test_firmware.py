"""The firmware on an emulated Cortex-M4: what a client sees must be what the bench shows it.

Not covered, because the emulated machine has none of it: the CAN controller with its arbitration and
error states, PWM and dead time, the analog converter, flash, LEDs, the brake/coast button, the RC-PWM
input and the watchdog.
"""

import os
import time
import unittest

from emulator import ROOT, EmulatorTest, dmc60c

SOURCES = os.path.join(ROOT, "firmware", "src")

DUTY = 8_000
# Where the emulated board's application stands (firmware/memory/qemu.x).
SLOT, SLOT_SIZE = 0x2001_0000, 31 * 4096
NAME_FIELD = 1
VELOCITY_GAINS = {dmc60c.P_GAIN: dmc60c.fixed(0.25), dmc60c.I_GAIN: dmc60c.fixed(0.004),
                  dmc60c.F_GAIN: dmc60c.fixed(0.9)}
POSITION_GAINS = {dmc60c.P_GAIN: dmc60c.fixed(4), dmc60c.I_GAIN: dmc60c.fixed(0.004),
                  dmc60c.D_GAIN: dmc60c.fixed(100), dmc60c.I_ZONE: 400_000}


def fnv_1a(name: str) -> int:
    """The hash that a panic leaves of its file's name."""
    value = 0x811C9DC5
    for byte in name.encode():
        value = (value ^ byte) * 0x01000193 & 0xFFFF_FFFF
    return value


class Management(EmulatorTest):
    def test_enumeration(self):
        answers = self.enumerate()
        first, second = (dmc60c.enum_response(message.data) for message in answers)
        self.assertEqual(first.product >> 20, 0x602)
        self.assertEqual(first.session, second.session)
        self.assertNotEqual(first.session, 0)
        self.assertEqual(second.image, dmc60c.APPLICATION)
        self.assertEqual((second.application_version, second.bootloader_version),
                         (0x0117, 0x0109))

    def test_frames_for_others_change_nothing(self):
        self.enumerate()
        others = [dmc60c.enumerate_request()._replace(id=0x02000240),
                  dmc60c.control(self.number + 1, dmc60c.VOLTAGE, DUTY),
                  dmc60c.param_request(self.number, self.session ^ 1, dmc60c.P_GAIN)]
        seen = self.ask(*others, periods=20)
        self.assertFalse(self.pick(seen, dmc60c.ENUM_RESPONSE))
        self.assertFalse(self.pick(seen, dmc60c.PARAM_RESPONSE))
        self.assertEqual(self.general(seen).duty, 0)

    def test_parameters_are_written_read_and_refused(self):
        self.enumerate()
        self.set(dmc60c.P_GAIN, -12345)
        self.assertEqual(self.get(dmc60c.P_GAIN), -12345)
        unknown = self.parameter(dmc60c.param_request(self.number, self.session, 100))
        self.assertEqual(unknown.error, dmc60c.PARAM_BAD_PARAMETER)
        beyond = dmc60c.param_set(self.number, self.session, dmc60c.FWD_DISABLED, 2)
        self.assertEqual(self.parameter(beyond).error, dmc60c.PARAM_BAD_VALUE)
        self.assertEqual(self.get(dmc60c.FWD_DISABLED), 0)

    def test_number_and_name_survive_a_restart_in_the_same_session(self):
        self.enumerate()
        status, _ = self.command(dmc60c.SET_DEVICE_NUMBER, 9)
        self.assertEqual(status.error, dmc60c.NO_ERROR)
        self.number = 9
        status, _ = self.command(dmc60c.SET_DEVICE_NAME, 6, b"winch\0")
        self.assertEqual(status.error, dmc60c.NO_ERROR)
        status, _ = self.command(dmc60c.SOFT_RESET)
        self.assertEqual(status.error, dmc60c.ACK_RESET)
        status, stream = self.command(dmc60c.GET_DESCRIPTORS)
        self.assertEqual(status.count, len(stream))
        self.assertEqual(dmc60c.descriptors(stream)[NAME_FIELD], "winch")
        session = self.session
        self.enumerate()
        self.assertEqual((self.number, self.session), (9, session))

    def test_closing_the_channel_is_the_loss_of_the_bus(self):
        self.enumerate()
        before = self.session
        self.drive(dmc60c.VOLTAGE, DUTY, periods=10)
        self.quiet()
        self.bus.close()
        self.bus.open()
        self.send(dmc60c.enumerate_request())
        self.watch(10)
        self.enumerate()
        self.assertNotEqual(self.session, before)
        self.assertEqual(self.get(dmc60c.STICKY_FAULTS), dmc60c.FAULT_COMMUNICATION)
        self.assertEqual(self.get(dmc60c.COUNT_COMMUNICATION), 1)


class Log(EmulatorTest):
    def test_what_happens_is_logged(self):
        self.enumerate()
        self.emulator.poke("gate_driver_fault", 1)
        self.watch(10)
        self.emulator.crash("panic")
        time.sleep(0.2)
        self.emulator.wait_until_up()
        self.ask(dmc60c.enumerate_request(), periods=20)
        lines = "\n".join(self.emulator.log())
        self.assertRegex(lines, r"INFO +started: Reset \{ cause: PowerOn.* count: 0 \}")
        self.assertIn(f"bus seen, session {self.session:#x}", lines)
        self.assertRegex(lines, r"ERROR +faults 0b1000")
        self.assertRegex(lines, r"ERROR +started: Reset \{ cause: Panic, detail: \d+.* count: 1 \}")


class Driving(EmulatorTest):
    def setUp(self):
        super().setUp()
        self.enumerate()

    def configure(self, settings: dict):
        for parameter, value in settings.items():
            self.set(parameter, value)

    def velocity(self, seen: list):
        """The velocity of one period's frames, if they tell it."""
        frames = self.pick(seen, dmc60c.STATUS_ENCODER)
        return dmc60c.Encoder(frames[-1].data).velocity if frames else None

    def position(self, seen: list):
        """The position of one period's frames, if they tell it."""
        frames = self.pick(seen, dmc60c.STATUS_ENCODER)
        return dmc60c.Encoder(frames[-1].data).position if frames else None

    def test_voltage_mode_turns_the_motor_both_ways(self):
        self.set(dmc60c.ENCODER_PERIOD, 10)
        for duty in (DUTY, -DUTY):
            self.drive(dmc60c.VOLTAGE, duty)
            # 32767 throttle units turn the free motor at some 36 400 counts per 100 ms.
            self.settle(self.velocity, duty * 36_400 // 32_767, 700)
            self.assertEqual(self.general(self.watch(1)).duty, duty)

    def test_velocity_mode_settles_within_three_percent(self):
        self.configure({dmc60c.ENCODER_PERIOD: 10, **VELOCITY_GAINS})
        for target in (12_000, -6_000):
            self.drive(dmc60c.VELOCITY, target)
            self.settle(self.velocity, target, abs(target) * 3 // 100)
            self.assertEqual(self.general(self.watch(1)).mode, dmc60c.VELOCITY)

    def test_position_mode_ends_within_two_counts(self):
        self.configure({dmc60c.ENCODER_PERIOD: 10, **POSITION_GAINS})
        for target in (4_096, -2_000):
            self.drive(dmc60c.POSITION, target)
            self.settle(self.position, target, 2)

    def test_output_goes_off_104_ms_after_the_last_control_frame(self):
        self.set(dmc60c.GENERAL_PERIOD, 2)
        self.drive(dmc60c.VOLTAGE, DUTY, periods=20)
        self.quiet()
        self.drain()
        self.send(dmc60c.control(self.number, dmc60c.VOLTAGE, DUTY + 1))
        periods = 0
        while self.general(self.watch(1)).duty != DUTY + 1:
            periods += 1
            self.assertLess(periods, 20, "the last control frame was not obeyed")
        periods = 1
        while self.general(self.watch(1)).duty != 0:
            periods += 1
            self.assertLess(periods, 60, "the output stays on without a control frame")
        # 104 ms are 52 periods; the first status is up to one period late.
        self.assert_near(periods, 52, 1)

    def test_soft_limit_stops_forward_only(self):
        self.configure({dmc60c.SOFT_FWD_THRESHOLD: 3_000, dmc60c.SOFT_FWD_ENABLE: 1})
        status = self.general(self.drive(dmc60c.VOLTAGE, DUTY, periods=120))
        self.assertEqual(status.duty, 0)
        self.assertTrue(status.soft_fwd_hit)
        self.assertEqual(self.general(self.drive(dmc60c.VOLTAGE, -DUTY, periods=10)).duty, -DUTY)

    def test_limit_switches_stop_their_own_direction(self):
        for poke, duty in (("fwd_limit_closed", DUTY), ("rev_limit_closed", -DUTY)):
            with self.subTest(poke=poke):
                self.emulator.poke(poke, 1)
                self.assertEqual(self.general(self.drive(dmc60c.VOLTAGE, duty, periods=10)).duty, 0)
                away = self.general(self.drive(dmc60c.VOLTAGE, -duty, periods=10))
                self.assertEqual(away.duty, -duty)
                self.emulator.poke(poke, 0)
                self.assertEqual(self.general(self.drive(dmc60c.VOLTAGE, duty, periods=10)).duty,
                                 duty)

    def test_gate_driver_fault_keeps_the_output_off_for_three_seconds(self):
        self.drive(dmc60c.VOLTAGE, DUTY, periods=10)
        self.emulator.poke("gate_driver_fault", 1)
        status = self.general(self.drive(dmc60c.VOLTAGE, DUTY, periods=10))
        self.assertEqual(status.duty, 0)
        self.assertTrue(status.gate_driver)
        self.emulator.poke("gate_driver_fault", 0)
        self.drain()
        periods = 0
        while self.general(self.watch(1)).duty == 0:
            periods += 1
            self.assertLess(periods, 400, "the output does not come back")
        self.assert_near(periods, 300, 8)
        self.assertEqual(self.get(dmc60c.STICKY_FAULTS), dmc60c.FAULT_GATE_DRIVER)
        self.assertEqual(self.get(dmc60c.COUNT_GATE_DRIVER), 1)

    def test_under_voltage_after_five_seconds(self):
        self.emulator.poke("battery_mv", 5_000)
        seen = self.drive(dmc60c.VOLTAGE, 500, periods=480)
        self.assertFalse(self.general(seen).under_voltage)
        seen = self.watch(40)
        self.assertEqual(self.general(seen).duty, 0)
        self.assertTrue(self.general(seen).under_voltage)

    def test_short_circuit_trips_the_gate_driver(self):
        self.emulator.poke("short_circuit", 1)
        seen = self.drive(dmc60c.VOLTAGE, DUTY, periods=10)
        self.assertEqual(self.general(seen).duty, 0)
        self.assertTrue(self.general(seen).gate_driver)


class Crash(EmulatorTest):
    def crash(self, how: str) -> tuple:
        """Crashes while the motor is driven; gives what the controller tells of its start over the bus."""
        self.enumerate()
        self.assertEqual(self.get(dmc60c.RESET_CAUSE), dmc60c.RESET_POWER_ON)
        self.assertEqual(self.get(dmc60c.RESET_COUNT), 0)
        self.drive(dmc60c.VOLTAGE, DUTY)
        self.quiet()
        self.emulator.crash(how)
        time.sleep(0.2)
        self.emulator.wait_until_up()
        # A new node: it has forgotten the bus, and its output is off.
        seen = self.ask(dmc60c.enumerate_request(), periods=20)
        self.assertEqual(self.general(seen).duty, 0)
        self.enumerate()
        self.assertEqual(self.get(dmc60c.RESET_COUNT), 1)
        return tuple(self.get(parameter) & 0xFFFF_FFFF for parameter in (
            dmc60c.RESET_CAUSE, dmc60c.RESET_DETAIL, dmc60c.RESET_PLACE))

    def test_a_panic_is_told_after_the_restart(self):
        self.enumerate()
        self.assertEqual(self.get(dmc60c.CRASH_CAUSE), 0)
        cause, line, file = self.crash("panic")
        self.assertEqual(cause, dmc60c.RESET_PANIC)
        source = os.path.join(SOURCES, "board", "qemu", "console.rs")
        with open(source, encoding="utf-8") as text:
            self.assertIn("panic!", text.readlines()[line - 1])
        self.assertEqual(file, fnv_1a("firmware/src/board/qemu/console.rs"))
        # It is known for longer than the cause of the latest start.
        status, _ = self.command(dmc60c.SOFT_RESET)
        self.assertEqual(status.error, dmc60c.ACK_RESET)
        self.assertEqual(self.get(dmc60c.RESET_CAUSE), dmc60c.RESET_REQUESTED)
        kept = tuple(self.get(parameter) & 0xFFFF_FFFF for parameter in (
            dmc60c.CRASH_CAUSE, dmc60c.CRASH_DETAIL, dmc60c.CRASH_PLACE))
        self.assertEqual(kept, (cause, line, file))

    def test_a_processor_fault_is_told_after_the_restart(self):
        cause, status, instruction = self.crash("fault")
        # Bit 16 of the fault status: undefined instruction.
        self.assertEqual((cause, status), (dmc60c.RESET_FAULT, 1 << 16))
        self.assertIn(instruction - SLOT, range(SLOT_SIZE))

    def test_an_unexpected_interrupt_is_told_after_the_restart(self):
        # TIM5 is interrupt 50.
        self.assertEqual(self.crash("interrupt"), (dmc60c.RESET_INTERRUPT, 50, 0))

    def test_a_stack_overflow_is_told_after_the_restart(self):
        cause, _, pointer = self.crash("stack")
        self.assertEqual(cause, dmc60c.RESET_STACK)
        self.assertLess(pointer, 0x2000_0000)

    def test_a_restart_that_was_asked_for_is_told(self):
        self.enumerate()
        status, _ = self.command(dmc60c.SOFT_RESET)
        self.assertEqual(status.error, dmc60c.ACK_RESET)
        self.assertEqual(self.get(dmc60c.RESET_CAUSE), dmc60c.RESET_REQUESTED)
        self.assertEqual(self.get(dmc60c.RESET_COUNT), 1)


class Flood(EmulatorTest):
    """In virtual time, because what is measured is a matter of single instructions."""

    sleep = False

    def test_the_tick_starts_on_time_under_a_flood_of_frames(self):
        self.enumerate()
        self.emulator.flood()
        for value in range(20):
            # Each change sends the tick a new set of settings, the longest critical section there is.
            self.set(dmc60c.P_GAIN, value)
            self.watch(10)
        jitter = self.emulator.jitter()
        self.note("jitter", jitter)
        self.assertLess(jitter, 5)


if __name__ == "__main__":
    unittest.main()
