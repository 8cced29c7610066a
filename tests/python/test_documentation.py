"""The examples of docs/python.md, run as they stand there."""

import os
import re
import subprocess
import sys
import tempfile
import unittest

from windlass_bench import Bench

PAGE = os.path.join(os.path.dirname(__file__), "..", "..", "docs", "python.md")
PATIENCE_SECONDS = 60


def examples() -> list:
    with open(PAGE, encoding="utf-8") as page:
        return re.findall(r"^```python\n(.*?)^```", page.read(), re.MULTILINE | re.DOTALL)


class Examples(unittest.TestCase):
    def run_text(self, text: str, *arguments: str) -> str:
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "example.py")
            with open(path, "w", encoding="utf-8") as script:
                script.write(text)
            done = subprocess.run(
                [sys.executable, path, *arguments], capture_output=True, text=True, check=False,
                timeout=PATIENCE_SECONDS,
                env={**os.environ, "PYTHONPATH": os.path.dirname(__file__)})
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return done.stdout + done.stderr

    def bench(self, node: str = "dmc60c:0", **options) -> Bench:
        bench = Bench((node,), **options)
        self.addCleanup(bench.close)
        return bench

    def test_driving_in_real_time(self):
        output = self.run_text(examples()[0], self.bench(paused=False).endpoints["slcan"])
        self.assertIn("device number 5 set, error code 0", output)
        self.assertRegex(output, r"target 15000, velocity 1[45]\d\d\d ")

    def test_a_talon(self):
        bench = self.bench("talon:3", paused=False)
        output = self.run_text(examples()[1], bench.endpoints["slcan"])
        self.assertRegex(output, r"throttle 511 of 1023, velocity 1[5-9]\d\d\d ")

    def test_virtual_time(self):
        bench = self.bench()
        text = examples()[2].replace("http://127.0.0.1:20001", bench.endpoints["http"].rstrip("/"))
        text = text.replace("127.0.0.1:20000", bench.endpoints["slcan"])
        self.assertIn("0206f000", self.run_text(text).lower())

    def test_library(self):
        output = self.run_text(examples()[3] + "\n\nimport unittest\nunittest.main()\n")
        self.assertIn("Ran 1 test", output)


if __name__ == "__main__":
    unittest.main()
