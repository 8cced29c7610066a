"""The same seed and the same client give the same frames at the same virtual times."""

import unittest

import dmc60c
from windlass_bench import Bench, BenchTest, Client, Controller


class Determinism(BenchTest):
    CONNECT = False

    def story(self, *args: str) -> list:
        """A whole session of a client; returns every frame with its time."""
        self.bench = Bench(("dmc60c:0", "dmc60c:3"), args=args)
        self.addCleanup(self.bench.close)
        self.client = Client("socket://" + self.bench.endpoints["slcan"])
        self.addCleanup(self.client.close)
        trace = self.exchange(dmc60c.enumerate_request(), us=100_000)
        session = next(dmc60c.enum_response(seen.data).session for seen in trace
                       if seen.from_node and seen.id == dmc60c.ENUM_RESPONSE | 3)
        device = Controller(self, 3, session)
        trace += device.run(dmc60c.VOLTAGE, 9_000, 400_000)
        self.bench.poke(1, load_nm=0.3)
        trace += device.run(dmc60c.VOLTAGE, -9_000, 400_000)
        return [(seen.t_us, seen.id, seen.data) for seen in trace]

    def test_twice_the_same(self):
        once, again = self.story("--seed", "7"), self.story("--seed", "7")
        self.assertGreater(len(once), 100)
        self.assertEqual(once, again)

    def test_the_seed_decides_the_sessions(self):
        self.assertNotEqual(self.story("--seed", "7"), self.story("--seed", "8"))

    def test_a_lossy_bus_is_as_repeatable(self):
        lossy = ("--seed", "7", "--loss", "0.02")
        self.assertEqual(self.story(*lossy), self.story(*lossy))


if __name__ == "__main__":
    unittest.main()
