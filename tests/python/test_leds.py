"""The four LEDs of the ring and the brake/coast LED."""

import unittest

import dmc60c
from windlass_bench import BenchTest

RAINBOW = {"red", "orange", "yellow", "green", "blue", "fuchsia", "cyan"}


class LedTest(BenchTest):
    def leds(self) -> tuple:
        """Colours of the ring, clockwise, and of the brake/coast LED."""
        leds = self.bench.node()["leds"]
        return tuple(leds["ring"]), leds["brake"]

    def ring(self) -> tuple:
        return self.leds()[0]

    def watch(self, us: int, every_us: int = 25_000, keep=None) -> list:
        """The ring over time, one entry a change: (time, colours)."""
        found = []
        end = self.bench.now + us
        while self.bench.now < end:
            if keep and not (self.bench.now // every_us) % 2:
                self.send(keep)
            self.step(every_us)
            ring = self.ring()
            if not found or found[-1][1] != ring:
                found.append((self.bench.now, ring))
        return found


class Ring(LedTest):
    def test_no_bus_is_red_blinking_once_a_second(self):
        states = self.watch(3_000_000)
        self.assertEqual({ring for _, ring in states}, {("red",) * 4, ("off",) * 4})
        changes = [later[0] - earlier[0] for earlier, later in zip(states[1:], states[2:])]
        for span in changes:
            self.assertNear(span, 500_000, 50_000)

    def test_halted_is_orange_alternating_side_to_side(self):
        self.one()
        states = self.watch(2_000_000)
        rings = {ring for _, ring in states}
        self.assertEqual(len(rings), 2, rings)
        one, other = rings
        for ring in rings:
            self.assertEqual(sorted(ring), ["off", "off", "orange", "orange"])
        for left, right in zip(one, other):
            self.assertEqual({left, right}, {"off", "orange"}, "the two sides change places")
        self.assertGreaterEqual(len(states), 4)

    def test_zero_setpoint_keeps_the_halted_indication(self):
        device = self.one()
        states = self.watch(1_500_000, keep=device.control(dmc60c.VOLTAGE, 0))
        self.assertEqual({colour for _, ring in states for colour in ring}, {"off", "orange"})
        self.assertGreaterEqual(len(states), 2)

    def test_full_output_is_solid_green_or_red(self):
        device = self.one()
        for duty, colour in ((32_767, "green"), (-32_768, "red")):
            device.run(dmc60c.VOLTAGE, duty, 200_000)
            states = self.watch(500_000, keep=device.control(dmc60c.VOLTAGE, duty))
            self.assertEqual([ring for _, ring in states], [(colour,) * 4])

    def test_the_light_runs_clockwise_forward_and_back_in_reverse(self):
        device = self.one()
        for duty, colour, direction in ((16_000, "green", 1), (-16_000, "red", -1)):
            device.run(dmc60c.VOLTAGE, duty, 100_000)
            states = self.watch(1_500_000, every_us=5_000,
                                keep=device.control(dmc60c.VOLTAGE, duty))
            lit = [ring.index(colour) for _, ring in states if ring.count(colour) == 1]
            self.assertGreater(len(lit), 4)
            steps = {(later - earlier) % 4 for earlier, later in zip(lit, lit[1:])}
            self.assertEqual(steps, {direction % 4})

    def test_neutral_in_no_fault_after_driving_is_orange(self):
        device = self.one()
        device.run(dmc60c.VOLTAGE, 10_000, 100_000)
        device.run(dmc60c.VOLTAGE, 0, 100_000)
        self.assertIn("orange", self.ring())

    def test_fault_alternates_red_and_orange(self):
        self.one()
        self.bench.poke(0, gate_driver_fault=True)
        states = self.watch(4_000_000)
        colours = {colour for _, ring in states for colour in ring}
        self.assertTrue({"red", "orange"} <= colours, colours)
        self.assertFalse({"green", "blue"} & colours)


class Identify(LedTest):
    def test_rainbow_for_five_seconds_and_back(self):
        device = self.one()
        device.command(dmc60c.FLASH_LEDS)
        start = self.bench.now
        states = self.watch(4_900_000, every_us=50_000)
        colours = {colour for _, ring in states for colour in ring} - {"off"}
        self.assertEqual(colours, RAINBOW)
        self.step(start + 5_050_000 - self.bench.now)
        states = self.watch(1_500_000)
        self.assertEqual({colour for _, ring in states for colour in ring}, {"off", "orange"})

    def test_it_does_not_touch_the_output(self):
        device = self.one()
        device.run(dmc60c.VOLTAGE, 9_000, 50_000)
        status, _ = device.command(dmc60c.FLASH_LEDS)
        self.assertEqual(status, (dmc60c.NO_ERROR, 0))
        self.assertEqual(self.duty(), 9_000)


class BrakeLed(LedTest):
    def test_red_in_brake_and_off_in_coast(self):
        device = self.one()
        self.assertEqual(self.leds()[1], "red")
        device.run(dmc60c.VOLTAGE, 0, 50_000, brake=False)
        self.assertEqual(self.leds()[1], "off")
        device.run(dmc60c.VOLTAGE, 0, 50_000, brake=True)
        self.assertEqual(self.leds()[1], "red")

    def test_bootloader_shows_white_running(self):
        device = self.one()
        device.command(dmc60c.ENTER_BOOTLOADER, us=500_000)
        states = self.watch(1_500_000)
        self.assertEqual({colour for _, ring in states for colour in ring}, {"off", "white"})
        self.assertGreater(len(states), 3)


if __name__ == "__main__":
    unittest.main()
