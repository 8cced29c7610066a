"""`windlass flash` against the real bootloader and application in QEMU."""

import json
import os
import subprocess
import tempfile
import time
import unittest

from emulator import STARTUP_SECONDS, dmc60c, given
from test_bootloader import INCOMPLETE, NEW, NO_VERSION, PAGE, PAGES, BootloaderTest, pack

UPDATE_SECONDS = 300  # the emulator may fall behind when the machine is busy


class HostToolTest(BootloaderTest):
    """With an image of a new version in a file, and the line left to the command."""

    def setUp(self):
        super().setUp()
        self.image = pack(NEW)
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.file = os.path.join(folder.name, "new.bin")
        with open(self.file, "wb") as file:
            for number in range(PAGES):
                file.write(self.image.get(number, b"\xff" * PAGE))

    def start(self, *arguments) -> subprocess.Popen:
        """Starts the command on the line, which this test leaves to it."""
        command = [given("WINDLASS_COMMAND"), "flash", self.file, *arguments, "--transport", self.emulator.leave()]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self.addCleanup(process.stdout.close)
        self.addCleanup(process.wait)
        self.addCleanup(process.kill)
        return process

    def flash(self) -> dict:
        """Updates the only controller; gives what the command tells of it."""
        process = self.start("--json")
        printed, _ = process.communicate(timeout=UPDATE_SECONDS)
        self.assertEqual(process.returncode, 0, printed)
        [device] = json.loads(printed)["devices"]
        return device

    def rejoin(self):
        self.emulator.join()
        self.bus = self.emulator.bus

    def assert_new_version_runs(self):
        self.rejoin()
        self.assert_new_version_answers()

    def assert_new_version_answers(self):
        self.assertEqual(self.find(), NEW)
        versions = self.versions()
        self.assertEqual((versions.flags & 3, versions.application), (dmc60c.APPLICATION, NEW))


class HostTool(HostToolTest):
    def test_windlass_flash_ends_with_the_new_version_answering(self):
        device = self.flash()
        self.assertEqual((device["before"], device["version"]), ("1.23", "1.24"))
        self.assertEqual((device["sent"], device["pages"]), (len(self.image), len(self.image)))
        self.assert_new_version_runs()

    def test_windlass_flash_goes_on_with_an_update_that_was_interrupted(self):
        process = self.start()
        # Killed in the middle of its pages, without a chance to tell anybody.
        for line in process.stdout:
            if line.split()[-1:] == ["write"]:
                break
        else:
            self.fail("the command has not come to write")
        time.sleep(1)
        process.kill()
        process.wait(STARTUP_SECONDS)
        self.rejoin()
        self.assertEqual(self.find(), NO_VERSION)
        # And a reset, as after a loss of power: nobody acknowledges.
        self.send(dmc60c.vendor_command(self.number, self.session, dmc60c.SOFT_RESET))
        self.settle_reset()
        self.assertEqual(self.find(), NO_VERSION)
        reason, stored, wanted = self.boot_status()
        self.assertEqual(reason, INCOMPLETE)
        stored, wanted = stored.bit_count(), wanted.bit_count()
        self.assertTrue(0 < stored < wanted, f"{stored} of {wanted} pages are stored")
        device = self.flash()
        self.assertEqual((device["sent"], device["version"]), (wanted - stored, "1.24"))
        self.assert_new_version_runs()


if __name__ == "__main__":
    unittest.main()
