"""The bootloader that checks signatures, in QEMU: keys and signed images, over the bus and with `windlass`."""

import os
import subprocess
import unittest

from emulator import dmc60c, given
from test_bootloader import GET_BOOT_STATUS, GET_PAGE_CRCS, NEW, NO_ERROR, NO_VERSION, OLD, PAGE, BootloaderTest, pack
from test_host import UPDATE_SECONDS, HostToolTest

NUMBER = 7
INSTALL_KEY = 0xE4
BAD_SIGNATURE, KEY_REFUSED = 0x27, 0x29
KEY_INSTALLED = 2  # flag of the boot status
# Base point of Ed25519, which is a public key like any other, and points of order 4 and 1, which are none (RFC 8032).
KEY = b"\x58" + 31 * b"\x66"
ORDER_4, NEUTRAL = bytes(32), b"\x01" + bytes(31)


class Signed(BootloaderTest):
    bootloader = "WINDLASS_SIGNED_BOOTLOADER"

    def has_key(self) -> bool:
        error, data = self.order(GET_BOOT_STATUS)
        self.assertEqual(error, NO_ERROR)
        return bool(data[2] & KEY_INSTALLED)

    def install(self, order: bytes) -> int:
        return self.order(INSTALL_KEY, len(order), 0, order)[0]


class Refusals(Signed):
    def test_an_unsigned_image_is_refused_once_a_key_is_installed_and_nothing_is_written(self):
        self.enter()
        for weak in [ORDER_4, NEUTRAL]:
            self.assertEqual(self.install(weak), KEY_REFUSED)
        self.assertFalse(self.has_key())
        self.assertEqual(self.install(KEY), NO_ERROR)
        self.assertTrue(self.has_key())
        before = self.order(GET_PAGE_CRCS)
        self.assertEqual(self.page(pack(NEW), 30), BAD_SIGNATURE)
        self.assertEqual(self.order(GET_PAGE_CRCS), before)
        # Nobody replaces the key without it: not at all, and not by a signature that fits no message.
        self.assertEqual(self.install(NEUTRAL), KEY_REFUSED)
        self.assertEqual(self.install(KEY), KEY_REFUSED)
        self.assertEqual(self.install(KEY + NEUTRAL + bytes(32)), KEY_REFUSED)
        # The image that was there before the key goes on running.
        self.order(dmc60c.SOFT_RESET)
        versions = self.versions()
        self.assertEqual((versions.flags & 3, versions.application), (dmc60c.APPLICATION, OLD))


class Walk(Signed, HostToolTest):
    """What a maker of devices does, with nothing but the command."""

    def windlass(self, *arguments, fails=False) -> str:
        done = subprocess.run([given("WINDLASS_COMMAND"), *arguments], stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, text=True, timeout=UPDATE_SECONDS, check=False)
        self.assertEqual(done.returncode != 0, fails, done.stdout)
        return done.stdout

    def on_line(self, *arguments, fails=False) -> str:
        printed = self.windlass(*arguments, "--transport", self.emulator.leave(), fails=fails)
        self.rejoin()
        return printed

    def install_key(self, key: str, *arguments, fails=False) -> str:
        return self.on_line("image", "install-key", str(NUMBER), f"{key}.pub", "--permanently", *arguments, fails=fails)

    def make_keys(self, *names) -> list:
        folder = os.path.dirname(self.file)
        keys = [os.path.join(folder, name) for name in names]
        for key in keys:
            self.windlass("image", "keygen", key)
        return keys

    def sign(self, key: str, extension="wlimg") -> str:
        signed = f"{key}.{extension}"
        self.windlass("image", "sign", self.file, "--key", f"{key}.key", "--output", signed)
        self.windlass("image", "verify", signed, "--key", f"{key}.pub")
        return signed

    def test_only_images_of_the_installed_key_start_and_the_key_is_replaced_by_its_own_consent(self):
        maker, stranger = self.make_keys("maker", "stranger")
        # Closing the line ends the session, so that the command needs another name for the device.
        self.find()
        self.assertEqual(self.order(dmc60c.SET_DEVICE_NUMBER, NUMBER)[0], NO_ERROR)
        self.number = NUMBER
        self.install_key(maker)
        # Another one's image arrives whole, is not committed and does not start.
        with open(self.sign(stranger, "bin"), "rb") as file:
            signed = file.read()
        self.enter()
        for number in sorted(self.image, reverse=True):
            expected = BAD_SIGNATURE if number == 0 else NO_ERROR
            self.assertEqual(self.page({number: signed[number * PAGE:(number + 1) * PAGE]}, number), expected)
        self.assertEqual(self.find(), NO_VERSION)
        self.assertTrue(self.has_key())
        self.send(dmc60c.vendor_command(self.number, self.session, dmc60c.SOFT_RESET))
        self.settle_reset()
        self.assertEqual(self.find(), NO_VERSION)
        versions = self.versions()
        self.assertEqual(versions.flags & 3, dmc60c.BOOTLOADER)
        # The controller can be flashed again at once.
        self.on_line("flash", self.sign(maker))
        self.assert_new_version_answers()
        # The installed key is replaced by an order that it has signed, and by no other.
        self.install_key(stranger, fails=True)
        self.install_key(stranger, "--replaces", f"{stranger}.key", fails=True)
        self.install_key(stranger, "--replaces", f"{maker}.key")
        self.install_key(maker, "--replaces", f"{maker}.key", fails=True)
        self.install_key(maker, "--replaces", f"{stranger}.key")
        self.assert_new_version_answers()


if __name__ == "__main__":
    unittest.main()
