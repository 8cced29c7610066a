"""The SLCAN ports: python-can over TCP and over the pty, several clients, and the raw protocol."""

import os
import socket
import unittest

import can

import dmc60c
from dmc60c import Frame
from windlass_bench import ApiError, Bench, BenchTest, Client

ANSWER_SECONDS = 10


class Raw:
    """A bare SLCAN client: lines out, answers in."""

    def __init__(self, address: str):
        host, port = address.rsplit(":", 1)
        self.socket = socket.create_connection((host, int(port)), timeout=ANSWER_SECONDS)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.buffer = b""

    def line(self) -> bytes:
        """The next answer, with the byte that ends it: CR for yes, BEL for no."""
        while True:
            for at, byte in enumerate(self.buffer):
                if byte in (0x0D, 0x07):
                    line, self.buffer = self.buffer[:at + 1], self.buffer[at + 1:]
                    return line
            received = self.socket.recv(4096)
            if not received:
                raise ConnectionError("the port was closed")
            self.buffer += received

    def say(self, command: bytes):
        """A command that is answered only if it is wrong."""
        self.socket.sendall(command + b"\r")

    def ask(self, command: bytes) -> bytes:
        self.socket.sendall(command + b"\r")
        return self.line()

    def close(self):
        self.socket.close()


class RawTest(BenchTest):
    CONNECT = False

    def raw(self) -> Raw:
        raw = Raw(self.bench.endpoints["slcan"])
        self.addCleanup(raw.close)
        return raw

    def opened(self) -> Raw:
        raw = self.raw()
        self.assertEqual(raw.ask(b"S8"), b"\r")
        self.assertEqual(raw.ask(b"O"), b"\r")
        return raw


class Protocol(RawTest):
    def test_version_and_serial_number(self):
        raw = self.raw()
        self.assertRegex(raw.ask(b"V"), rb"^V[0-9A-F]{4}\r$")
        self.assertRegex(raw.ask(b"N"), rb"^N[0-9A-Za-z]{4}\r$")

    def test_unknown_and_malformed_commands_get_a_bell(self):
        raw = self.opened()
        for command in (b"?", b"Q9x", b"T", b"t12", b"t1239", b"T0000000190", b"tXYZ0",
                        b"t80000", b"T200000000", b"t1232AABB00", b"t1232A"):
            with self.subTest(command=command):
                self.assertEqual(raw.ask(command), b"\x07")
        self.assertRegex(raw.ask(b"V"), rb"^V", "the port goes on working")

    def test_a_closed_channel_sends_nothing(self):
        raw = self.opened()
        self.assertEqual(raw.ask(b"C"), b"\r")
        self.assertEqual(raw.ask(b"t1230"), b"\x07")
        self.bench.advance(5_000)
        self.assertEqual(self.bench.trace(), [])

    def test_an_open_channel_can_not_change_its_bit_rate(self):
        raw = self.opened()
        self.assertEqual(raw.ask(b"S6"), b"\x07")

    def test_frames_of_each_kind_reach_the_bus(self):
        raw = self.opened()
        for command in (b"t1232AABB", b"T1234567830a0B0c", b"r7FF4", b"R1FFFFFFF8", b"t0000"):
            raw.say(command)
        self.assertRegex(raw.ask(b"V"), rb"^V", "a frame has no answer of its own")
        self.bench.advance(5_000)
        sent = [(seen.id, seen.ext, seen.rtr, seen.dlc, seen.data)
                for seen in self.bench.trace() if not seen.from_node]
        self.assertEqual(sorted(sent), sorted([
            (0x123, False, False, 2, b"\xaa\xbb"), (0x12345678, True, False, 3, b"\x0a\x0b\x0c"),
            (0x7FF, False, True, 4, b""), (0x1FFFFFFF, True, True, 8, b""),
            (0x000, False, False, 0, b"")]))

    def test_received_frames_have_their_line(self):
        raw = self.opened()
        self.bench.inject(Frame(0x12345678, b"\x0a\xff"))
        self.bench.inject(Frame(0x7FF, b"", ext=False))
        self.bench.advance(400)
        lines = {raw.line(), raw.line()}
        self.assertEqual(lines, {b"T1234567820AFF\r", b"t7FF0\r"})

    def test_time_stamps_in_milliseconds(self):
        raw = self.raw()
        raw.ask(b"S8")
        self.assertEqual(raw.ask(b"Z1"), b"\r")
        raw.ask(b"O")
        self.bench.advance(61_000_000)  # stamps start again from 0 after a minute
        self.bench.inject(Frame(0x100, b"", ext=False))
        self.bench.advance(400)
        line = raw.line()
        self.assertRegex(line, rb"^t1000[0-9A-F]{4}\r$")
        self.assertNear(int(line[5:9], 16), 1_000, 1)

    def test_listen_only_receives_and_does_not_send(self):
        raw = self.raw()
        raw.ask(b"S8")
        self.assertEqual(raw.ask(b"L"), b"\r")
        self.assertEqual(raw.ask(b"t1230"), b"\x07")
        other = self.opened()
        other.say(b"t4560")
        self.bench.advance(1_000)
        self.assertEqual(raw.line(), b"t4560\r")

    def test_a_long_line_without_end_does_no_harm(self):
        raw = self.raw()
        raw.socket.sendall(b"x" * 100_000)
        self.assertEqual(raw.ask(b""), b"\x07")
        self.assertRegex(raw.ask(b"V"), rb"^V")
        self.bench.advance(1_000)

    def test_a_client_that_leaves_in_the_middle_does_no_harm(self):
        raw = self.opened()
        raw.socket.sendall(b"T0206000")
        raw.close()
        self.bench.advance(10_000)
        self.assertRegex(self.raw().ask(b"V"), rb"^V")


class Replies(RawTest):
    ARGS = ("--slcan-replies",)

    def test_accepted_frames_are_answered_when_asked_for(self):
        raw = self.opened()
        self.assertEqual(raw.ask(b"t1230"), b"z\r")
        self.assertEqual(raw.ask(b"T123456780"), b"Z\r")
        self.assertEqual(raw.ask(b"T12345678"), b"\x07")


class Clients(BenchTest):
    NODES = ("dmc60c:0", "dmc60c:0")

    def test_each_client_sees_the_frames_of_the_others_and_not_its_own(self):
        second = Client("socket://" + self.bench.endpoints["slcan"])
        self.addCleanup(second.close)
        mark = Frame(0x1ABCDEF0, b"mark")
        second.send(mark)
        trace = self.exchange(us=2_000)
        self.assertEqual([seen.id for seen in trace if not seen.from_node], [mark.id])
        ours = second.receive(len(second.expected(trace)))
        self.assertNotIn(mark.id, [message.arbitration_id for message in ours])

    def test_a_client_that_goes_leaves_the_rest_running(self):
        second = Client("socket://" + self.bench.endpoints["slcan"])
        self.wake()
        second.close()
        self.assertTrue(self.pick(self.step(100_000), dmc60c.STATUS_GENERAL))


class BasicClient:
    """What every python-can user does first; run over each kind of port."""

    NODES = ("dmc60c:0", "dmc60c:0")

    def test_enumerate_renumber_configure_drive_and_fall_silent(self):
        found = self.enumerate()
        for _ in range(3):
            found = found if len(found) == 2 else self.enumerate()
        self.assertEqual([device.number for device in found], [0, 0])
        first, second = found
        status, _ = first.command(dmc60c.SET_DEVICE_NUMBER, 8)
        self.assertEqual(status, (dmc60c.NO_ERROR, 0))
        first.number = 8
        self.assertEqual(first.descriptors()[2], "Digilent")
        index = 0 if self.bench.node(0)["number"] == 8 else 1
        first.configure({dmc60c.F_GAIN: dmc60c.fixed(0.9), dmc60c.P_GAIN: dmc60c.fixed(0.25)})
        targets = {dmc60c.VOLTAGE: 8_000, dmc60c.VELOCITY: 8_000, dmc60c.POSITION: 1_000,
                   dmc60c.CURRENT: dmc60c.fixed(5), dmc60c.VOLTAGE_COMPENSATION: dmc60c.fixed(4)}
        for mode, target in targets.items():
            trace = first.run(mode, target, 200_000)
            self.assertEqual(first.general(trace).mode, mode)
        trace = first.drive(dmc60c.follow(8, 0), 100_000)
        self.assertEqual(first.general(trace).mode, dmc60c.FOLLOWER)
        first.run(dmc60c.VOLTAGE, 8_000, 50_000)
        self.assertEqual(self.duty(index), 8_000)
        self.step(110_000)
        self.assertEqual(self.duty(index), 0)
        self.exchange(us=100_000)
        self.assertEqual(second.get(dmc60c.GENERAL_PERIOD), 10)


class OverTcp(BasicClient, BenchTest):
    pass


class OverPty(BasicClient, BenchTest):
    PTY = True

    def connect(self, channel=None):
        super().connect(channel or self.bench.endpoints["pty"])

    def test_the_pty_is_a_terminal(self):
        self.assertTrue(os.path.exists(self.bench.endpoints["pty"]))
        self.assertRegex(self.bench.endpoints["pty"], r"^/dev/")


class RealTime(unittest.TestCase):
    def test_without_paused_the_bench_runs_by_itself(self):
        bench = Bench(("dmc60c:3",), paused=False, args=("--speed", "20"))
        self.addCleanup(bench.close)
        bus = can.Bus(interface="slcan", channel="socket://" + bench.endpoints["slcan"],
                      bitrate=1_000_000, sleep_after_open=0)
        self.addCleanup(bus.shutdown)
        bus.send(can.Message(arbitration_id=dmc60c.ENUM, is_extended_id=True))
        for _ in range(1_000):
            message = bus.recv(ANSWER_SECONDS)
            self.assertIsNotNone(message, "nothing was received")
            if message.arbitration_id == dmc60c.ENUM_RESPONSE | 3:
                return
        self.fail("no enumeration answer among 1000 frames")


    def test_it_can_not_be_stepped(self):
        bench = Bench(paused=False)
        self.addCleanup(bench.close)
        with self.assertRaises(ApiError) as refusal:
            bench.advance(1_000)
        self.assertEqual(refusal.exception.status, 409)


class Process(unittest.TestCase):
    def test_endpoint_lines_and_a_clean_end(self):
        bench = Bench(("dmc60c:5", "dmc60c:7"), pty=True)
        self.assertEqual(bench.lines[-1], "ready")
        self.assertRegex(bench.endpoints["slcan"], r"^127\.0\.0\.1:\d+$")
        self.assertRegex(bench.endpoints["http"], r"^http://127\.0\.0\.1:\d+/$")
        self.assertEqual(len(bench.lines), 4)
        self.assertEqual(bench.close(), 0, "Ctrl-C ends it cleanly")


if __name__ == "__main__":
    unittest.main()
