"""The entry point of `python -m ffsms_pin`, equal to the command `ffsms-pin`."""

import sys

from ffsms_pin.cli import main

sys.exit(main())
