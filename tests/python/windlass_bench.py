"""A virtual bench for tests: starts `windlass sim`, drives it with python-can and its JSON API.

Everything happens in virtual time. The bench is started with `--paused`; nothing moves until a
test asks for a step, and times are read from the bench's own trace of the bus.
"""

import collections
import json
import os
import re
import select
import signal
import subprocess
import tempfile
import unittest
import unittest.mock
import urllib.error
import urllib.request
from typing import NamedTuple

import can

import dmc60c
from dmc60c import Frame

STARTUP_SECONDS = 20  # a hung start must end the test, not the patience of whoever runs it
ANSWER_SECONDS = 20


def binary() -> str:
    """The windlass binary: WINDLASS_BIN, or the newest build of this workspace."""
    named = os.environ.get("WINDLASS_BIN")
    if named:
        return named
    root = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
    built = [os.path.join(root, "target", profile, "windlass") for profile in ("debug", "release")]
    built = [path for path in built if os.path.exists(path)]
    if not built:
        raise FileNotFoundError(
            "no windlass binary: build it with `cargo build --bin windlass` or name one in "
            "WINDLASS_BIN")
    return max(built, key=os.path.getmtime)


class Seen(NamedTuple):
    """A frame of the trace: what was on the bus, when its last bit ended, and who sent it."""

    seq: int
    t_us: int
    id: int
    data: bytes
    ext: bool
    rtr: bool
    dlc: int
    source: object  # a node's index, or the name of a client

    @property
    def from_node(self) -> bool:
        return isinstance(self.source, int)

    @property
    def base(self) -> int:
        """The identifier without the device number."""
        return self.id & ~dmc60c.NUMBER_MASK

    @property
    def number(self) -> int:
        return self.id & dmc60c.NUMBER_MASK


class ApiError(Exception):
    """The bench refused a request."""

    def __init__(self, status: int, body: str):
        super().__init__(f"HTTP {status}: {body}")
        self.status = status
        self.body = body


class Bench:
    """One `windlass sim` process."""

    def __init__(self, nodes=("dmc60c:0",), *, paused=True, pty=False, args=()):
        command = [binary(), "sim"]
        for node in nodes:
            command += ["--node", node]
        command += ["--slcan", "127.0.0.1:0", "--http", "127.0.0.1:0"]
        command += ["--paused"] if paused else []
        command += ["--pty"] if pty else []
        command += args
        self._errors = tempfile.TemporaryFile(mode="w+")
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=self._errors)
        self.endpoints = {}
        self.lines = []
        self._read_endpoints()
        self._next = 0  # number of the first frame of the trace not yet read
        self.now = 0  # virtual time in µs, as counted from the steps that were asked for

    def _read_endpoints(self):
        text = ""
        while "ready" not in self.lines:
            ready, _, _ = select.select([self.process.stdout], [], [], STARTUP_SECONDS)
            received = os.read(self.process.stdout.fileno(), 4096) if ready else b""
            if not received:
                self.process.kill()
                self.process.wait()
                raise RuntimeError(f"the bench did not come up: {text!r} {self.errors()}")
            text += received.decode()
            self.lines = text.splitlines() if text.endswith("\n") else []
        for line in self.lines[:-1]:
            kind, _, value = line.partition(" ")
            self.endpoints[kind] = value

    def errors(self) -> str:
        """What the process wrote to its standard error."""
        self._errors.seek(0)
        return self._errors.read()

    def close(self) -> int:
        """Ends the process as Ctrl-C does; returns its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(10)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self.process.stdout.close()
        self._errors.close()
        return self.process.returncode

    # --- JSON API ---------------------------------------------------------------------------

    def request(self, method: str, path: str, body=None, raw: bytes | None = None):
        """One request; returns the decoded answer, raises `ApiError` on a refusal."""
        data = raw if raw is not None else None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(
            self.endpoints["http"].rstrip("/") + path, data=data, method=method,
            headers={"Content-Type": "application/json"} if data is not None else {})
        try:
            with urllib.request.urlopen(request, timeout=ANSWER_SECONDS) as answer:
                text = answer.read().decode()
        except urllib.error.HTTPError as refusal:
            with refusal:
                raise ApiError(refusal.code, refusal.read().decode()) from None
        return json.loads(text) if text else None

    def state(self) -> dict:
        return self.request("GET", "/api/sim")

    def node(self, index: int = 0) -> dict:
        """Plant truth and pins of one controller."""
        return self.request("GET", f"/api/sim/nodes/{index}")

    def poke(self, index: int = 0, **fields):
        """Changes the world of one controller: closes a switch, sags the battery, ..."""
        return self.request("PATCH", f"/api/sim/nodes/{index}", fields)

    def power_cycle(self, index: int = 0):
        return self.request("POST", f"/api/sim/nodes/{index}/power-cycle")

    def advance(self, us: int):
        """Virtual time goes on by exactly `us` microseconds."""
        self.request("POST", "/api/sim/step", {"us": us})
        self.now += us

    def inject(self, frame: Frame):
        """A frame from one more participant of the bus."""
        return self.request("POST", "/api/sim/frames", {
            "id": frame.id, "ext": frame.ext, "data": frame.data.hex()})

    def trace(self) -> list:
        """The frames that were on the bus since the last call."""
        found = []
        while True:
            page = self.request("GET", f"/api/sim/trace?since={self._next}&limit=5000")
            if not page:
                return found
            found += [self._entry(entry) for entry in page]
            self._next = found[-1].seq + 1

    @staticmethod
    def _entry(entry: dict) -> Seen:
        return Seen(entry["seq"], entry["t_us"], entry["id"], bytes.fromhex(entry["data"]),
                    entry["ext"], entry["rtr"], entry["dlc"], entry["from"])


class Client:
    """python-can on the bench's SLCAN port."""

    def __init__(self, channel: str):
        self.bus = can.Bus(interface="slcan", channel=channel, bitrate=1_000_000,
                           sleep_after_open=0)
        self._sent = collections.Counter()
        self.synchronise()

    def synchronise(self):
        """Throws away what is waiting, much faster than frame by frame. The answer to a version
        query marks the end: while the bench is paused nothing can follow it."""
        self.bus.serialPortOrig.write(b"V\r")
        tail, end = b"", re.compile(rb"(?:^|[\r\a])V[0-9A-F]{4}\r$")
        while not end.search(tail):
            ready, _, _ = select.select([self.bus.fileno()], [], [], ANSWER_SECONDS)
            received = os.read(self.bus.fileno(), 1 << 16) if ready else b""
            if not received:
                raise RuntimeError("the SLCAN port does not answer V")
            tail = (tail + received)[-64:]

    def send(self, frame: Frame):
        self.bus.send(can.Message(
            arbitration_id=frame.id, is_extended_id=frame.ext, is_remote_frame=frame.rtr,
            data=None if frame.rtr else frame.data, dlc=frame.length))
        self._sent[(frame.id, bytes(frame.data), frame.ext, frame.rtr)] += 1

    def expected(self, trace: list) -> list:
        """Which frames of the trace this client must receive: all but its own."""
        wanted = []
        for seen in trace:
            key = (seen.id, seen.data, seen.ext, seen.rtr)
            if not seen.from_node and self._sent[key]:
                self._sent[key] -= 1
            else:
                wanted.append(seen)
        return wanted

    def receive(self, count: int) -> list:
        """Exactly `count` messages, as python-can delivers them."""
        received = []
        while len(received) < count:
            message = self.bus.recv(ANSWER_SECONDS)
            if message is None:
                break
            received.append(message)
        return received

    def close(self):
        """Leaves the bus; may be called again."""
        if self.bus:
            # pyserial sleeps for 0.3 s after it closed a socket, out of care for slow servers.
            with unittest.mock.patch("time.sleep"):
                self.bus.shutdown()
            self.bus = None


class BenchTest(unittest.TestCase):
    """A test with a bench of its own and one python-can client on its SLCAN port."""

    NODES = ("dmc60c:0",)
    ARGS = ()
    PTY = False
    CONNECT = True

    def setUp(self):
        self.bench = Bench(self.NODES, args=self.ARGS, pty=self.PTY)
        self.addCleanup(self.bench.close)
        self.client = None
        self._skipped_us = 0
        if self.CONNECT:
            self.connect()

    def connect(self, channel: str | None = None):
        channel = channel or "socket://" + self.bench.endpoints["slcan"]
        self.client = Client(channel)
        self.addCleanup(self.client.close)

    def step(self, us: int) -> list:
        """Lets virtual time pass; returns the trace of that span."""
        self.bench.advance(us)
        trace = self.bench.trace()
        if self.client:
            self.client.expected(trace)
            self._skipped_us += us
            if self._skipped_us > 1_000_000:
                self._catch_up()
        return trace

    def _catch_up(self):
        if self._skipped_us:
            self.client.synchronise()
            self._skipped_us = 0

    def send(self, *frames: Frame):
        for frame in frames:
            self.client.send(frame)

    def exchange(self, *frames: Frame, us: int = 5_000) -> list:
        """Sends frames and lets time pass; returns the trace, which is checked to be what
        python-can received."""
        self._catch_up()
        self.send(*frames)
        self.bench.advance(us)
        trace = self.bench.trace()
        wanted = self.client.expected(trace)
        received = self.client.receive(len(wanted))
        self.assertEqual(
            [(m.arbitration_id, bytes(m.data), m.is_extended_id) for m in received],
            [(seen.id, seen.data, seen.ext) for seen in wanted],
            "python-can did not receive what was on the bus")
        return trace

    def wake(self):
        """Any frame on the bus makes a controller notice it; this one means nothing."""
        self.exchange(Frame(0x123, b"", ext=False), us=1_000)

    def enumerate(self, us: int = 100_000) -> list:
        """All controllers that answer, as `Controller`s in the order of their first answers."""
        trace = self.exchange(dmc60c.enumerate_request(), us=us)
        found, second = {}, {}
        for seen in trace:
            if seen.from_node and seen.base == dmc60c.ENUM_RESPONSE:
                answer = dmc60c.enum_response(seen.data)
                table = found if isinstance(answer, dmc60c.EnumResponse0) else second
                table[(seen.number, answer.session)] = answer
        self.assertEqual(set(found), set(second), "each ENUMRSP0 is followed by its ENUMRSP1")
        return [Controller(self, number, session, first, second[(number, session)])
                for (number, session), first in found.items()]

    def one(self) -> "Controller":
        """The only controller of this bench, found by enumeration."""
        found = self.enumerate()
        self.assertEqual(len(found), 1, f"expected one controller, found {found}")
        return found[0]

    # --- reading the trace ------------------------------------------------------------------

    @staticmethod
    def pick(trace: list, base: int, number: int | None = None) -> list:
        """The frames from controllers with this message identifier."""
        return [seen for seen in trace if seen.from_node and seen.ext and seen.base == base
                and (number is None or seen.number == number)]

    def last(self, trace: list, base: int, number: int | None = None) -> Seen:
        frames = self.pick(trace, base, number)
        self.assertTrue(frames, f"no frame {base:#010x} in the trace")
        return frames[-1]

    def duty(self, index: int = 0) -> int:
        return self.bench.node(index)["duty"]

    def assertNear(self, value, wanted, tolerance, message=None):
        self.assertLessEqual(abs(value - wanted), tolerance,
                             f"{value} is not {wanted} ± {tolerance}. {message or ''}")


class Controller:
    """One DMC60C as a host sees it: a device number and a session."""

    def __init__(self, test: BenchTest, number: int, session: int, first=None, second=None):
        self.test, self.number, self.session = test, number, session
        self.first, self.second = first, second

    def __repr__(self):
        return f"Controller(number={self.number}, session={self.session:#06x})"

    # --- parameters -------------------------------------------------------------------------

    def _param_answer(self, trace: list, parameter: int) -> dmc60c.ParamResponse:
        answers = self.test.pick(trace, dmc60c.PARAM_RESPONSE, self.number)
        self.test.assertEqual(len(answers), 1, "exactly one PARAMRESP")
        response = dmc60c.param_response(answers[0].data)
        self.test.assertEqual(response.parameter, parameter)
        return response

    def request(self, parameter: int) -> dmc60c.ParamResponse:
        frame = dmc60c.param_request(self.number, self.session, parameter)
        return self._param_answer(self.test.exchange(frame, us=2_000), parameter)

    def put(self, parameter: int, value: int) -> dmc60c.ParamResponse:
        frame = dmc60c.param_set(self.number, self.session, parameter, value)
        return self._param_answer(self.test.exchange(frame, us=2_000), parameter)

    def get(self, parameter: int) -> int:
        """The value of a parameter as a signed number."""
        response = self.request(parameter)
        self.test.assertEqual(response.error, dmc60c.PARAM_NO_ERROR)
        return response.signed

    def set(self, parameter: int, value: int):
        response = self.put(parameter, value)
        self.test.assertEqual((response.signed, response.error), (value, dmc60c.PARAM_NO_ERROR),
                              f"parameter {parameter} was set to {value}")

    def configure(self, settings: dict):
        for parameter, value in settings.items():
            self.set(parameter, value)

    # --- vendor commands --------------------------------------------------------------------

    def command(self, command: int, parameter1=0, parameter2=0, payload=b"", chunk=8,
                us: int = 10_000):
        """A vendor command with its data; returns the status (or None) and the data in."""
        frames = [dmc60c.vendor_command(self.number, self.session, command, parameter1,
                                        parameter2)]
        frames += dmc60c.data_out(self.number, payload, chunk)
        trace = self.test.exchange(*frames, us=us)
        # Renumbering is answered from the new number, so the number is not looked at here.
        replies = self.test.pick(trace, dmc60c.VENDOR_STATUS)
        self.test.assertLessEqual(len(replies), 1, "one VENDORSTS at most")
        data = [seen.data for seen in self.test.pick(trace, dmc60c.VENDOR_DATA_IN, self.number)]
        return dmc60c.vendor_status(replies[0].data) if replies else None, b"".join(data)

    def set_text(self, command: int, text: str) -> dmc60c.VendorStatus:
        payload = text.encode("ascii") + b"\0"
        return self.command(command, len(payload), payload=payload, us=60_000)[0]

    def descriptors(self) -> dict:
        status, stream = self.command(dmc60c.GET_DESCRIPTORS, us=20_000)
        self.test.assertEqual(status, (dmc60c.NO_ERROR, len(stream)))
        return dmc60c.descriptors(stream)

    # --- driving ----------------------------------------------------------------------------

    def control(self, mode: int, target=0, **options) -> Frame:
        return dmc60c.control(self.number, mode, target, **options)

    def drive(self, frame: Frame, us: int, period_us: int = 50_000) -> list:
        """Repeats a control frame as a host does, for `us`; returns the trace."""
        trace, left = [], us
        while left > 0:
            span = min(period_us, left)
            self.test.send(frame)
            trace += self.test.step(span)
            left -= span
        return trace

    def run(self, mode: int, target: int, us: int, **options) -> list:
        return self.drive(self.control(mode, target, **options), us)

    def general(self, trace: list) -> dmc60c.General:
        return dmc60c.General(self.test.last(trace, dmc60c.STATUS_GENERAL, self.number).data)

    def encoder(self, trace: list) -> dmc60c.Encoder:
        return dmc60c.Encoder(self.test.last(trace, dmc60c.STATUS_ENCODER, self.number).data)

    def analog(self, trace: list) -> dmc60c.Analog:
        return dmc60c.Analog(self.test.last(trace, dmc60c.STATUS_ANALOG, self.number).data)

    def status(self) -> dmc60c.General:
        """The general status after another 11 ms."""
        return self.general(self.test.step(11_000))
