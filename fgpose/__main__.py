"""``python -m fgpose`` is the command fgpose."""

import sys

from fgpose.cli import main

sys.exit(main())
