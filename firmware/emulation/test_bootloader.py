"""The bootloader in QEMU: updates over the bus, with images that this file packs by docs/image-format.md alone."""

import struct
import time
import unittest
import zlib

from emulator import SILENCE_SECONDS, EmulatorTest, dmc60c, given

PAGE = 4096
PAGES = 31
INFO = 0x200
HEADER = 0xF00
OLD, NEW = 0x0117, 0x0118
NO_VERSION = 0xFFFF

GET_PAGE_CRCS, GET_BOOT_STATUS = 0xE0, 0xE2
NO_ERROR, CRC_MISMATCH, WRONG_PRODUCT, PAGE_ORDER = 0, 5, 0x21, 0x24
EMPTY, INCOMPLETE, TRIAL_FAILED = 2, 3, 5


def read_pages() -> dict:
    """The pages of the application that was built, without its header."""
    with open(given("WINDLASS_BINARY"), "rb") as file:
        binary = file.read()
    pages = {number: bytearray(binary[number * PAGE:(number + 1) * PAGE]) for number in range(PAGES)}
    pages[30][HEADER:] = b"\xff" * 256
    return {number: page for number, page in pages.items() if number == 30 or page.strip(b"\xff")}


def pack(version: int, product=None) -> dict:
    """The application that was built, as another version or for another product: only its information block and
    header differ."""
    pages = read_pages()
    info = pages[0][INFO:INFO + 64]
    if product is not None:
        info[0x08:0x0C] = struct.pack("<I", product)
    info[0x10:0x12] = struct.pack("<H", version)
    info[0x3C:] = struct.pack("<I", zlib.crc32(bytes(info[:0x3C])))
    pages[0][INFO:INFO + 64] = info
    header = bytearray(b"\xff" * 256)
    header[:8] = b"WLHD" + struct.pack("<HH", 1, 256)
    header[0x08:0x18] = info[0x08:0x18]
    header[0x18:0x1C] = struct.pack("<I", sum(1 << number for number in pages))
    header[0xFC:] = struct.pack("<HBB", version, 0x00, 0xFF)
    pages[30][HEADER:] = header
    whole = b"".join(bytes(pages[number]) for number in sorted(pages))
    header[0x1C:0x20] = struct.pack("<I", zlib.crc32(whole))
    header[0x3C:0x40] = struct.pack("<I", zlib.crc32(bytes(header)))
    pages[30][HEADER:] = header
    return {number: bytes(page) for number, page in pages.items()}


class BootloaderTest(EmulatorTest):
    def until_status(self) -> tuple:
        """The next status of a vendor command, and the data that follow it."""
        status, data = None, b""
        while status is None or len(data) < status.count:
            message = self.bus.recv(SILENCE_SECONDS)
            self.assertIsNotNone(message, "the controller has fallen silent")
            if self.base(message) == dmc60c.VENDOR_STATUS:
                status = dmc60c.vendor_status(message.data)
            elif self.base(message) == dmc60c.VENDOR_DATA_IN:
                data += bytes(message.data)
        return status, data

    def order(self, command: int, parameter1=0, parameter2=0, payload=b"") -> tuple:
        """A vendor command of application or bootloader."""
        self.drain()
        self.send(dmc60c.vendor_command(self.number, self.session, command, parameter1, parameter2))
        for frame in dmc60c.data_out(self.number, payload):
            self.send(frame)
        status, data = self.until_status()
        return status.error, data

    def find(self) -> int:
        """Enumerates; gives the version of the application as the controller tells it."""
        self.drain()
        self.send(dmc60c.enumerate_request())
        answers = []
        while len(answers) < 2:
            message = self.bus.recv(SILENCE_SECONDS)
            self.assertIsNotNone(message, "nobody answers the enumeration")
            if self.base(message) == dmc60c.ENUM_RESPONSE:
                answers.append(dmc60c.enum_response(message.data))
        self.session = answers[0].session
        return answers[1].application_version

    def versions(self) -> dmc60c.FirmwareVersion:
        error, data = self.order(dmc60c.GET_FIRMWARE_VERSION)
        self.assertEqual(error, NO_ERROR)
        return dmc60c.firmware_version(data)

    def page(self, image: dict, number: int, damage=0) -> int:
        """Sends one page; gives the result."""
        crc = zlib.crc32(image[number]) ^ damage
        payload = image[number] + struct.pack("<I", crc)
        return self.order(dmc60c.ERASE_WRITE_FLASH_PAGE, 0, number, payload)[0]

    def boot_status(self) -> tuple:
        """Reason, stored and wanted pages."""
        error, data = self.order(GET_BOOT_STATUS)
        self.assertEqual((error, data[0]), (NO_ERROR, 1))
        return data[1], *struct.unpack_from("<II", data, 12)

    def settle_reset(self):
        """What is sent while the chip restarts is lost."""
        time.sleep(0.5)
        self.emulator.wait_until_up()

    def enter(self):
        """From the application into the bootloader, in the same session."""
        self.find()
        error, _ = self.order(dmc60c.ENTER_BOOTLOADER)
        self.assertEqual(error, dmc60c.IN_BOOTLOADER)


class Update(BootloaderTest):
    def test_an_update_ends_with_the_new_version_running(self):
        self.enter()
        versions = self.versions()
        self.assertEqual((versions.flags & 3, versions.application), (dmc60c.BOOTLOADER, OLD))
        image = pack(NEW)
        for number in sorted(image, reverse=True):
            self.assertEqual(self.page(image, number), NO_ERROR)
            expected = NEW if number == 0 else NO_VERSION
            self.assertEqual(self.versions().application, expected)
        error, _ = self.order(dmc60c.SOFT_RESET)
        self.assertEqual(error, dmc60c.ACK_RESET)
        # The application that was written runs, and knows its own version from its own flash.
        versions = self.versions()
        self.assertEqual((versions.flags & 3, versions.application), (dmc60c.APPLICATION, NEW))
        self.assertEqual(self.get(dmc60c.RESET_CAUSE), dmc60c.RESET_REQUESTED)

    def test_an_image_for_another_product_changes_nothing(self):
        self.enter()
        before = self.order(GET_PAGE_CRCS)
        foreign = pack(NEW, product=0x1234)
        self.assertEqual(self.page(foreign, 30), WRONG_PRODUCT)
        self.assertEqual(self.order(GET_PAGE_CRCS), before)
        self.assertEqual(self.versions().application, OLD)
        self.order(dmc60c.SOFT_RESET)
        versions = self.versions()
        self.assertEqual((versions.flags & 3, versions.application), (dmc60c.APPLICATION, OLD))

    def test_an_interrupted_update_stays_in_the_bootloader_and_is_resumed(self):
        self.enter()
        image = pack(NEW)
        order = sorted(image, reverse=True)
        half = len(order) // 2
        for number in order[:half]:
            self.assertEqual(self.page(image, number), NO_ERROR)
        self.assertEqual(self.page(image, order[half], damage=1), CRC_MISMATCH)
        # A reset in the middle: there is no image to start, and nobody acknowledges.
        self.send(dmc60c.vendor_command(self.number, self.session, dmc60c.SOFT_RESET))
        self.settle_reset()
        self.assertEqual(self.find(), NO_VERSION)
        reason, stored, wanted = self.boot_status()
        self.assertEqual(reason, INCOMPLETE)
        self.assertEqual(stored, sum(1 << number for number in order[:half]))
        self.assertEqual(wanted, sum(1 << number for number in order))
        # A stored page that is sent again is acknowledged if it is the same.
        self.assertEqual(self.page(image, order[1]), NO_ERROR)
        self.assertEqual(self.page({order[1]: bytes(PAGE)}, order[1]), PAGE_ORDER)
        for number in order[half:]:
            self.assertEqual(self.page(image, number), NO_ERROR)
        self.order(dmc60c.SOFT_RESET)
        self.assertEqual(self.versions().application, NEW)

    def test_number_and_name_set_in_the_bootloader_hold_in_the_application(self):
        self.enter()
        self.assertEqual(self.order(dmc60c.SET_DEVICE_NUMBER, 7)[0], NO_ERROR)
        self.number = 7
        name = b"lift\0"
        self.assertEqual(self.order(dmc60c.SET_DEVICE_NAME, len(name), 0, name)[0], NO_ERROR)
        self.order(dmc60c.SOFT_RESET)
        error, data = self.order(dmc60c.GET_DESCRIPTORS)
        self.assertEqual((error, dmc60c.descriptors(data)[1]), (NO_ERROR, "lift"))


class Empty(BootloaderTest):
    application = False

    def test_a_controller_without_an_application_can_be_given_one(self):
        self.assertEqual(self.find(), NO_VERSION)
        self.assertEqual(self.boot_status(), (EMPTY, 0, 0))
        image = pack(NEW)
        for number in sorted(image, reverse=True):
            self.assertEqual(self.page(image, number), NO_ERROR)
        self.order(dmc60c.SOFT_RESET)
        self.assertEqual(self.versions().application, NEW)


class Trial(BootloaderTest):
    def note_stack(self):
        """The test ends in the bootloader, which does not tell."""

    def test_an_application_that_crashes_three_times_on_trial_is_not_started_again(self):
        crashes = 0
        while self.emulator.console_answers():
            self.emulator.crash("panic")
            self.settle_reset()
            crashes += 1
            self.assertLess(crashes, 20, "the application starts again and again")
        self.find()
        versions = self.versions()
        self.assertEqual((versions.flags & 3, versions.application), (dmc60c.BOOTLOADER, OLD))
        error, data = self.order(GET_BOOT_STATUS)
        self.assertEqual((error, data[1], data[3]), (NO_ERROR, TRIAL_FAILED, 3))


if __name__ == "__main__":
    unittest.main()
