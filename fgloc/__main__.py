"""`python -m fgloc` is the command `fgloc`."""

import sys

from fgloc.cli import main

sys.exit(main())
