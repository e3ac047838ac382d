"""`python -m radiant_app` is the command `radiant`."""

import sys

from radiant_app.cli.app import main

sys.exit(main())
