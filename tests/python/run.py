#!/usr/bin/env python3
"""Runs the Python acceptance tests of the bench.

    python3 tests/python/run.py [path of the windlass binary] [unittest options]

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
    names = [name for name in arguments if not name.startswith("-")]
    options = [name for name in arguments if name.startswith("-")]
    if not names:
        names = ["discover", "-s", HERE, "-p", "test_*.py"]
    program = unittest.main(module=None, argv=["run.py", *names, *options], exit=False)
    return 0 if program.result.wasSuccessful() else 1


if __name__ == "__main__":
    sys.exit(main())
