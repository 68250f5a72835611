"""For every test: lock files of buses in a folder of this process, so that tests side by side share no machine.

And one thread of linear algebra, set before numpy is loaded: on small matrices a second one only spins.
"""

from __future__ import annotations

import os
import tempfile

from service.bus_lock import FOLDER_VARIABLE

os.environ[FOLDER_VARIABLE] = tempfile.mkdtemp(prefix="breakaway-locks-")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
