"""`python -m ffsms_pin`: the same as the command `ffsms-pin`."""

import sys

from ffsms_pin.cli import main

sys.exit(main())
