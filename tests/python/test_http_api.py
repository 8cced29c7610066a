"""The JSON API as other projects use it."""

import urllib.request
import unittest

import dmc60c
from dmc60c import Frame
from windlass_bench import ApiError, BenchTest

NODE_FIELDS = {
    "dialect": str, "number": int, "position_counts": int, "velocity_counts_per_100ms": (int, float),
    "current_a": (int, float), "bus_v": (int, float), "temp_c": (int, float), "duty": int,
    "neutral": str, "fwd_limit_closed": bool, "rev_limit_closed": bool, "leds": object,
    "mode": str, "powered": bool, "flash_writes": int, "flash_erases": int,
}
POKES = {
    "fwd_limit_closed": True, "rev_limit_closed": True, "index_pin": True, "analog_v": 1.5,
    "battery_v": 11.5, "temp_c": 40.0, "load_nm": 0.1, "stall": True, "encoder_unplugged": True,
    "short_circuit": False, "gate_driver_fault": False, "bus_connected": True, "powered": True,
}
WRONG = {
    "fwd_limit_closed": "yes", "index_pin": 1, "analog_v": "1 V", "battery_v": "12",
    "temp_c": [20], "load_nm": {}, "stall": "false", "powered": 0,
}


class ApiTest(BenchTest):
    NODES = ("dmc60c:5", "dmc60c:6")

    def refused(self, method: str, path: str, body=None, raw=None) -> ApiError:
        with self.assertRaises(ApiError) as caught:
            self.bench.request(method, path, body, raw)
        return caught.exception


class State(ApiTest):
    def test_virtual_time_follows_the_steps_exactly(self):
        before = self.bench.state()["t_us"]
        for us in (1, 499, 500, 1_234_567):
            self.bench.advance(us)
            self.assertEqual(self.bench.state()["t_us"] - before, self.bench.now)

    def test_nothing_moves_while_paused(self):
        self.wake()
        before = self.bench.state()["t_us"]
        self.bench.node()
        self.assertEqual(self.bench.state()["t_us"], before)

    def test_overview(self):
        self.wake()
        self.step(500_000)
        state = self.bench.state()
        self.assertEqual(len(state["nodes"]), 2)
        self.assertGreater(state["bus_load_percent"], 0)
        self.assertLess(state["bus_load_percent"], 100)
        self.assertGreater(state["frames"], 100)
        self.assertEqual(state["error_frames"], 0)
        self.assertIn("speed", state)


class Nodes(ApiTest):
    def test_documented_fields_and_their_types(self):
        for index, number in ((0, 5), (1, 6)):
            node = self.bench.node(index)
            for name, kind in NODE_FIELDS.items():
                with self.subTest(name=name):
                    self.assertIn(name, node)
                    self.assertIsInstance(node[name], kind)
            self.assertEqual((node["dialect"], node["number"]), ("dmc60c", number))
            self.assertEqual((node["mode"], node["powered"]), ("application", True))
            self.assertIn(node["neutral"], ("brake", "coast"))

    def test_every_documented_field_can_be_set(self):
        for name, value in POKES.items():
            with self.subTest(name=name):
                self.bench.poke(0, **{name: value})
        self.step(5_000)
        node = self.bench.node(0)
        self.assertTrue(node["fwd_limit_closed"] and node["rev_limit_closed"])
        self.assertFalse(self.bench.node(1)["fwd_limit_closed"], "the other node is untouched")

    def test_several_fields_at_once(self):
        self.bench.poke(1, fwd_limit_closed=True, rev_limit_closed=True)
        node = self.bench.node(1)
        self.assertTrue(node["fwd_limit_closed"] and node["rev_limit_closed"])

    def test_unknown_fields_are_refused_by_name_and_change_nothing(self):
        refusal = self.refused("PATCH", "/api/sim/nodes/0",
                               {"fwd_limit_closed": True, "colour": "green"})
        self.assertEqual(refusal.status, 400)
        self.assertIn("colour", refusal.body)
        self.assertFalse(self.bench.node(0)["fwd_limit_closed"])

    def test_values_of_the_wrong_kind_are_refused_by_name(self):
        for name, value in WRONG.items():
            with self.subTest(name=name):
                refusal = self.refused("PATCH", "/api/sim/nodes/0", {name: value})
                self.assertEqual(refusal.status, 400)
                self.assertIn(name, refusal.body)

    def test_malformed_bodies_are_refused(self):
        for raw in (b"", b"{", b"[1]", b"\xff\xfe", b"null"):
            with self.subTest(raw=raw):
                self.assertEqual(self.refused("PATCH", "/api/sim/nodes/0", raw=raw).status, 400)
                self.assertEqual(self.refused("POST", "/api/sim/step", raw=raw).status, 400)

    def test_unknown_nodes_and_paths(self):
        for method, path in (("GET", "/api/sim/nodes/2"), ("GET", "/api/sim/nothing"),
                             ("POST", "/api/sim/nodes/9/power-cycle"), ("GET", "/api")):
            with self.subTest(path=path):
                self.assertEqual(self.refused(method, path).status, 404)
        self.assertIn(self.refused("GET", "/api/sim/nodes/-1").status, (400, 404))
        self.assertIn(self.refused("GET", "/api/sim/nodes/first").status, (400, 404))

    def test_wrong_methods(self):
        for method, path in (("DELETE", "/api/sim/nodes/0"), ("GET", "/api/sim/step"),
                             ("POST", "/api/sim/trace")):
            with self.subTest(method=method, path=path):
                self.assertEqual(self.refused(method, path).status, 405)

    def test_what_is_forced_is_listed_and_null_lets_it_go(self):
        self.bench.poke(0, battery_v=9.0)
        self.assertEqual(self.bench.node(0)["pokes"], {"battery_v": 9.0})
        self.step(5_000)
        self.assertNear(self.bench.node(0)["bus_v"], 9.0, 0.1)
        self.bench.poke(0, battery_v=None)
        self.step(5_000)
        self.assertGreater(self.bench.node(0)["bus_v"], 12.0)

    def test_power(self):
        self.wake()
        self.step(100_000)
        self.bench.poke(0, powered=False)
        trace = self.step(200_000)
        self.assertFalse(self.bench.node(0)["powered"])
        self.assertEqual({seen.source for seen in trace}, {1})
        self.bench.poke(0, powered=True)
        self.step(500_000)
        trace = self.step(100_000)
        self.assertEqual({seen.source for seen in trace}, {0, 1})


class Steps(ApiTest):
    def test_bad_spans_are_refused(self):
        for body in ({}, {"us": -1}, {"us": "5"}, {"us": 1.5}, {"ms": 5}, {"us": 5, "more": 1}):
            with self.subTest(body=body):
                self.assertEqual(self.refused("POST", "/api/sim/step", body).status, 400)
        self.assertEqual(self.bench.state()["t_us"], 0)

    def test_waiting_frames_go_first_and_all_received_ones_are_there(self):
        self.wake()
        for _ in range(20):
            self.exchange(dmc60c.enumerate_request(), us=20_000)

    def test_zero_is_allowed(self):
        self.bench.advance(0)
        self.assertEqual(self.bench.state()["t_us"], 0)


class Trace(ApiTest):
    def pages(self, query: str) -> list:
        return self.bench.request("GET", "/api/sim/trace" + query)

    def test_order_fields_and_paging(self):
        self.wake()
        self.bench.advance(500_000)
        whole = self.pages("?since=0&limit=1000")
        self.assertGreater(len(whole), 100)
        self.assertEqual(set(whole[0]), {"seq", "t_us", "id", "ext", "rtr", "dlc", "data", "from"})
        for earlier, later in zip(whole, whole[1:]):
            self.assertEqual(later["seq"], earlier["seq"] + 1)
            self.assertGreater(later["t_us"], earlier["t_us"])
        first = self.pages("?since=0&limit=7")
        self.assertEqual(first, whole[:7])
        self.assertEqual(self.pages(f"?since={first[-1]['seq'] + 1}"), whole[7:])
        self.assertEqual(self.pages(f"?since={whole[-1]['seq'] + 1}"), [])

    def test_source_is_the_node_or_the_client(self):
        self.wake()
        self.step(50_000)
        entries = self.pages("?since=0&limit=1000")
        self.assertIsInstance(entries[0]["from"], str)
        self.assertEqual({entry["from"] for entry in entries if entry["id"] >> 6 << 6 ==
                          dmc60c.STATUS_GENERAL}, {0, 1})

    def test_bad_queries_are_refused(self):
        for query in ("?since=x", "?limit=-1", "?since=0&limit=many", "?sinse=0"):
            with self.subTest(query=query):
                self.assertEqual(self.refused("GET", "/api/sim/trace" + query).status, 400)


class Injection(ApiTest):
    def test_a_frame_reaches_the_controllers_and_the_clients(self):
        self.wake()
        self.step(100_000)  # the self-check of a controller that was just switched on
        self.bench.inject(dmc60c.control(5, dmc60c.VOLTAGE, 4_444))
        trace = self.exchange(us=5_000)
        self.assertEqual(self.duty(0), 4_444)
        self.assertEqual(self.duty(1), 0)
        self.assertIn(dmc60c.CONTROL_0 | 5, [seen.id for seen in trace])

    def test_bad_frames_are_refused(self):
        for body in ({"id": 1 << 29, "ext": True, "data": ""}, {"id": 0x800, "ext": False, "data": ""},
                     {"id": 1, "ext": True, "data": "00" * 9}, {"id": 1, "ext": True, "data": "0"},
                     {"id": 1, "ext": True, "data": "zz"}, {"id": -1, "ext": True, "data": ""},
                     {"ext": True, "data": ""}, {"id": 1, "ext": 1, "data": ""},
                     {"id": 1, "ext": True, "data": "", "colour": 1}):
            with self.subTest(body=body):
                self.assertEqual(self.refused("POST", "/api/sim/frames", body).status, 400)

    def test_eleven_bit_frames(self):
        self.bench.inject(Frame(0x7FF, b"\1", ext=False))
        trace = self.exchange(us=1_000)
        self.assertEqual((trace[0].id, trace[0].ext, trace[0].data), (0x7FF, False, b"\1"))


class Page(ApiTest):
    def test_the_root_serves_a_page(self):
        with urllib.request.urlopen(self.bench.endpoints["http"]) as answer:
            self.assertEqual(answer.status, 200)
            self.assertIn("text/html", answer.headers["Content-Type"])
            self.assertIn(b"<html", answer.read().lower())


if __name__ == "__main__":
    unittest.main()
