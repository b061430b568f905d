"""Retention, carried out now and then by a thread of the service."""

import logging
import threading

from creak.errors import StorageError
from creak.sinks.database import Store
from creak.sinks.retention import keep_budget, thin_history

_log = logging.getLogger(__name__)

_HISTORY_SECONDS = 3600.0
_BUDGET_SECONDS = 30.0


class Upkeep:
    """Thins the history every hour, and keeps recordings within their budget.

    Parameters
    ----------
    store : Store
    budget : int or None
        Bytes that all recordings together may take; None for no limit.
    """

    def __init__(self, store: Store, budget: int | None = None) -> None:
        self._store = store
        self._budget = budget
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="upkeep", daemon=True)

    def start(self) -> None:
        """Begin; returns at once."""
        self._thread.start()

    def stop(self) -> None:
        """End; what is under way is finished by the database."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(1.0)

    def _run(self) -> None:
        left = 60.0  # a service that has just begun has better to do
        while not self._stop.wait(_BUDGET_SECONDS):
            left -= _BUDGET_SECONDS
            try:
                if self._budget is not None:
                    keep_budget(self._store, self._budget)
                if left <= 0:
                    left = _HISTORY_SECONDS
                    with self._store.write(durable=False) as connection:
                        thin_history(connection)
            except (StorageError, OSError) as error:
                _log.warning("upkeep is put off: %s", error)
            except Exception:  # noqa: BLE001 - the next turn may do what this one could not
                _log.exception("upkeep is put off")
