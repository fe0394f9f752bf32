"""A module that starts a thread when it is imported, so that nothing can be forked from whoever has imported it."""

from __future__ import annotations

import threading

threading.Thread(target=threading.Event().wait, name="of the module", daemon=True).start()
