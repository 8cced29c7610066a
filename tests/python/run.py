#!/usr/bin/env python3
"""Runs the Python acceptance tests of the bench.

    python3 tests/python/run.py [path of the windlass binary] [tests or unittest options]

for example `run.py target/debug/windlass test_limits` or `run.py -k soft`.

The binary may also be named by the environment variable WINDLASS_BIN. Needs python-can 4 and
pyserial (`pip install python-can pyserial`). Exit code 0 when every test passed.
"""

import os
import sys
import unittest

HERE = os.path.dirname(os.path.abspath(__file__))


def main() -> int:
    arguments = sys.argv[1:]
    if arguments and not arguments[0].startswith("-") and os.path.isfile(arguments[0]):
        os.environ["WINDLASS_BIN"] = os.path.abspath(arguments.pop(0))
    sys.path.insert(0, HERE)
    if not arguments or arguments[0].startswith("-"):
        arguments = ["discover", "-s", HERE, "-p", "test_*.py", *arguments]
    program = unittest.main(module=None, argv=["run.py", *arguments], exit=False)
    return 0 if program.result.wasSuccessful() else 1


if __name__ == "__main__":
    sys.exit(main())
