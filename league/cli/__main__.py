"""`python -m league.cli`."""

import sys

from league.cli import main

sys.exit(main())
