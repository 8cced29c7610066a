"""The firmware in QEMU, driven with python-can over SLCAN.

The emulated controller lives in real time, which it may fall behind when the machine is busy. Its
general status frame, one every ten milliseconds of its own time, is therefore the clock of these
tests: a span is a number of such frames, and so is the pace of the control frames.
"""

import os
import socket
import subprocess
import sys
import time
import unittest

import can

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
sys.path.insert(0, os.path.join(ROOT, "tests", "python"))

import dmc60c  # noqa: E402 (found in the folder above)

STARTUP_SECONDS = 60  # a hung start must end the test, not the patience of whoever runs it
SILENCE_SECONDS = 20
ANSWER_PERIODS = 1000
CLOCK_MHZ = 168


FACTORY = 0x0802_0000  # where the emulated board finds what its slot holds at power-on


def given(name: str) -> str:
    """A file that `cargo xtask qemu-test` names in the environment."""
    path = os.environ.get(name)
    if not path:
        raise FileNotFoundError(f"no {name}: run this through `cargo xtask qemu-test`")
    return path


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Emulator:
    """One QEMU process and the client's ends of its two serial lines."""

    def __init__(self, sleep: bool = True, application: bool = True, bootloader: str = "WINDLASS_BOOTLOADER"):
        """Without `sleep` the emulator's idle time takes no time, and its clock is exact to the
        instruction instead of near real time. Without `application` the slot is erased."""
        line, pokes = free_port(), free_port()
        factory = [
            "-device", f"loader,file={given('WINDLASS_SLOT')},addr={FACTORY:#x},force-raw=on",
        ] if application else []
        self.process = subprocess.Popen([
            "qemu-system-arm", "-M", "netduinoplus2", "-kernel", given(bootloader),
            *factory,
            "-display", "none", "-monitor", "none",
            "-serial", f"tcp:127.0.0.1:{line},server=on,wait=on,nodelay=on",
            "-serial", f"tcp:127.0.0.1:{pokes},server=on,wait=off,nodelay=on",
            "-semihosting-config", "enable=on,target=native",
            "-icount", f"shift=3,align=off,sleep={'on' if sleep else 'off'}",
        ], stderr=subprocess.PIPE, stdout=subprocess.PIPE)
        self.line_port, self.poke_port = line, pokes
        self.printed = None
        try:
            self._connect()
        except BaseException:
            self.close()
            raise

    def _connect(self):
        self.join()
        self.poker = self._retry(lambda: socket.create_connection(("127.0.0.1", self.poke_port)))
        self.poker.settimeout(SILENCE_SECONDS)

    def join(self):
        """Opens the line, which takes one client."""
        self.bus = self._retry(lambda: can.Bus(
            interface="slcan", channel=f"socket://127.0.0.1:{self.line_port}", bitrate=1_000_000,
            sleep_after_open=0))
        self.wait_until_up()

    def leave(self) -> str:
        """Closes the line for another client; gives its name as a transport of `windlass`."""
        self.bus.shutdown()
        del self.bus
        return f"tcp:127.0.0.1:{self.line_port}"

    def wait_until_up(self):
        """What is sent before the firmware has switched its serial line on is lost."""
        end = time.monotonic() + STARTUP_SECONDS
        while self.bus.get_version(0.2) == (None, None):
            if time.monotonic() > end:
                raise TimeoutError("the firmware does not answer on its serial line")

    def _retry(self, attempt):
        end = time.monotonic() + STARTUP_SECONDS
        while True:
            try:
                return attempt()
            except (OSError, can.CanError):
                if self.process.poll() is not None or time.monotonic() > end:
                    raise
                time.sleep(0.05)

    def poke(self, name: str, value):
        """Interferes with the plant, for example `poke("battery_mv", 5000)`."""
        answer = self._ask(f"{name} {value}\r".encode())
        if answer != b"ok\r":
            raise ValueError(f"poke {name} {value} was answered {answer!r}")

    def stack(self) -> int:
        """Bytes of the stack that have been used so far."""
        return int(self._ask(b"stack\r"))

    def crash(self, how: str):
        """Ends the program by "panic", "fault" or "interrupt"; it restarts."""
        self.poker.sendall(f"crash {how}\r".encode())

    def console_answers(self, seconds: float = 5) -> bool:
        """Whether the application runs: the bootloader does not listen here."""
        end = time.monotonic() + seconds
        self.poker.settimeout(0.5)
        try:
            while time.monotonic() < end:
                self.poker.sendall(b"\rstack\r")
                try:
                    if self.poker.recv(64):
                        return True
                except TimeoutError:
                    pass
            return False
        finally:
            self.poker.settimeout(SILENCE_SECONDS)

    def flood(self):
        """From now on a frame is received whenever the firmware looks for one."""
        self._ask(b"flood\r")

    def jitter(self) -> float:
        """Difference between the earliest and the latest start of a control tick so far, in µs."""
        return int(self._ask(b"jitter\r")) / CLOCK_MHZ

    def _ask(self, line: bytes) -> bytes:
        self.poker.sendall(line)
        answer = b""
        while not answer.endswith(b"\r"):
            part = self.poker.recv(16)
            if not part:
                raise ConnectionError("the emulator closed its poke line")
            answer += part
        return answer

    def log(self) -> list:
        """Ends the process and gives the lines of its log, decoded."""
        done = subprocess.run([os.environ["WINDLASS_XTASK"], "log", given("WINDLASS_IMAGE")], input=self.close(),
                              capture_output=True, check=True)
        return done.stdout.decode().splitlines()

    def close(self) -> bytes:
        """Ends the process and gives what it printed; once, then the same again."""
        if self.printed is not None:
            return self.printed
        if hasattr(self, "bus"):
            self.bus.shutdown()
        if hasattr(self, "poker"):
            self.poker.close()
        self.process.terminate()
        output, errors = self.process.communicate(timeout=STARTUP_SECONDS)
        self.printed = output + errors
        return self.printed


class EmulatorTest(unittest.TestCase):
    """One emulator for each test."""

    sleep = True
    application = True
    bootloader = "WINDLASS_BOOTLOADER"

    def setUp(self):
        self.emulator = Emulator(self.sleep, self.application, self.bootloader)
        self.addCleanup(self.emulator.close)
        self.addCleanup(self.note_stack)
        self.bus = self.emulator.bus
        self.number, self.session = 0, None
        self._beat = None

    def note(self, name: str, value: float):
        """Leaves a figure for the command that has started the test."""
        path = os.environ.get("WINDLASS_FIGURES")
        if path:
            with open(path, "a", encoding="ascii") as file:
                print(name, value, file=file)

    def note_stack(self):
        # A test that has ended the program has nobody to ask.
        if self.emulator.printed is None:
            self.note("stack", self.emulator.stack())

    # --- frames -------------------------------------------------------------------------------

    def send(self, frame: dmc60c.Frame):
        self.bus.send(can.Message(arbitration_id=frame.id, is_extended_id=frame.ext,
                                  is_remote_frame=frame.rtr, data=frame.data or None,
                                  dlc=frame.length))

    def receive(self) -> can.Message:
        message = self.bus.recv(SILENCE_SECONDS)
        self.assertIsNotNone(message, "the controller has fallen silent")
        return message

    def watch(self, periods: int) -> list:
        """All frames of this many general status periods."""
        seen = []
        while periods > 0:
            seen.append(self.receive())
            if self.base(seen[-1]) == dmc60c.STATUS_GENERAL:
                periods -= 1
                if self._beat is not None:
                    self.send(self._beat)
        return seen

    @staticmethod
    def base(message: can.Message) -> int:
        return message.arbitration_id & ~dmc60c.NUMBER_MASK

    def pick(self, seen: list, base: int) -> list:
        return [message for message in seen if self.base(message) == base]

    def drain(self):
        """Forgets what has been received so far."""
        while self.bus.recv(0) is not None:
            pass

    def ask(self, *frames: dmc60c.Frame, periods: int = 10) -> list:
        """Sends frames and gives what comes back."""
        self.drain()
        for frame in frames:
            self.send(frame)
        return self.watch(periods)

    # --- management ---------------------------------------------------------------------------

    def enumerate(self) -> list:
        """Session and answers of the one controller."""
        seen = self.ask(dmc60c.enumerate_request(), periods=20)
        answers = self.pick(seen, dmc60c.ENUM_RESPONSE)
        self.assertEqual([message.dlc for message in answers], [6, 8])
        self.number = answers[0].arbitration_id & dmc60c.NUMBER_MASK
        self.session = dmc60c.enum_response(answers[0].data).session
        return answers

    def command(self, command: int, parameter: int = 0, payload: bytes = b"", periods=10):
        """A vendor command: its status and the data that came with it."""
        frames = [dmc60c.vendor_command(self.number, self.session, command, parameter)]
        seen = self.ask(*frames, *dmc60c.data_out(self.number, payload), periods=periods)
        statuses = self.pick(seen, dmc60c.VENDOR_STATUS)
        self.assertEqual(len(statuses), 1)
        data = b"".join(bytes(part.data) for part in self.pick(seen, dmc60c.VENDOR_DATA_IN))
        return dmc60c.vendor_status(statuses[0].data), data

    def parameter(self, frame: dmc60c.Frame) -> dmc60c.ParamResponse:
        # Where virtual time runs ahead of real time, many periods may pass before the request is there.
        self.drain()
        self.send(frame)
        for _ in range(ANSWER_PERIODS):
            answers = self.pick(self.watch(1), dmc60c.PARAM_RESPONSE)
            if answers:
                self.assertEqual(len(answers), 1)
                return dmc60c.param_response(answers[0].data)
        self.fail(f"no answer to {frame}")

    def get(self, parameter: int) -> int:
        answer = self.parameter(dmc60c.param_request(self.number, self.session, parameter))
        self.assertEqual((answer.parameter, answer.error), (parameter, dmc60c.PARAM_NO_ERROR))
        return answer.signed

    def set(self, parameter: int, value: int):
        answer = self.parameter(dmc60c.param_set(self.number, self.session, parameter, value))
        self.assertEqual((answer.parameter, answer.error), (parameter, dmc60c.PARAM_NO_ERROR))
        self.assertEqual(answer.signed, value)

    # --- driving ------------------------------------------------------------------------------

    def drive(self, mode: int, target: int = 0, *, periods: int = 10, **options) -> list:
        """Drives from now on, one control frame for every general status, until `quiet` or another
        `drive`; gives the frames of the first `periods`."""
        self._beat = dmc60c.control(self.number, mode, target, **options)
        self.send(self._beat)
        self.drain()
        return self.watch(periods)

    def quiet(self):
        """Stops driving: no control frame is sent any more."""
        self._beat = None

    def settle(self, read, target: int, tolerance: int, *, periods: int = 500, steady: int = 20):
        """Goes on until `read` (of one period's frames) has stayed near the target for a while."""
        near = 0
        for _ in range(periods):
            value = read(self.watch(1))
            near = near + 1 if value is None or abs(value - target) <= tolerance else 0
            if near >= steady:
                return
        self.fail(f"{value} is not near {target} after {periods} periods")

    def general(self, seen: list) -> dmc60c.General:
        return dmc60c.General(self.pick(seen, dmc60c.STATUS_GENERAL)[-1].data)

    def encoder(self, seen: list) -> dmc60c.Encoder:
        return dmc60c.Encoder(self.pick(seen, dmc60c.STATUS_ENCODER)[-1].data)

    def assert_near(self, value, wanted, tolerance):
        self.assertLessEqual(abs(value - wanted), tolerance, f"{value} is not {wanted}")
