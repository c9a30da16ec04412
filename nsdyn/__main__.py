"""`python -m nsdyn`: the command."""

import sys

from nsdyn.cli import main

sys.exit(main())
