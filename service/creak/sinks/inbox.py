"""What operators ask of the rigs that one process measures: looked for once for all of them, not rig by rig."""

import threading
import time

from creak.sinks import actions
from creak.sinks.actions import Asked
from creak.sinks.database import Store

LOOK_SECONDS = 0.1


class Inbox:
    """Asks the store at most ten times a second, however many rigs want to know; safe to share between threads.

    Parameters
    ----------
    store : Store
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._rigs: frozenset[str] = frozenset()
        self._lock = threading.Lock()  # of who looks; the others take what was found last
        self._looked = float("-inf")
        self._found: dict[str, list[Asked]] = {}

    def waiting(self, rig: str, after: int) -> list[Asked]:
        """Return the actions beyond a place in their order that the monitor of a rig does not know.

        Raises
        ------
        StorageError
            If the store cannot be read.
        """
        new = rig not in self._rigs
        if (new or time.monotonic() - self._looked >= LOOK_SECONDS) and self._lock.acquire(blocking=new):
            try:
                self._looked = time.monotonic()
                self._rigs |= {rig}
                with self._store.read() as connection:
                    self._found = actions.waiting_for(connection, self._rigs)
            finally:
                self._lock.release()
        return [asked for asked in self._found.get(rig, ()) if asked.seq > after]

    def leave(self, rig: str) -> None:
        """Look no more for a rig whose run has ended: what is asked of it waits for its next worker."""
        self._rigs -= {rig}  # without the lock, which may be held for long: who still wants it enters again
