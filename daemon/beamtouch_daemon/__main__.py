"""`python -m beamtouch_daemon`."""

import sys

from beamtouch_daemon.cli import main

sys.exit(main())
