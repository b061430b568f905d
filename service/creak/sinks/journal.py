"""What a worker has sent, and which runs it has recorded: a small file beside the recordings."""

import json
import os
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from creak.codec.letters import Place
from creak.errors import StorageError
from creak.sinks.wholewrites import WholeWrites

_RUNS = 1000  # whose recordings a request can still reach


@dataclass(frozen=True)
class RecordedRun:
    """A run of the rig: when it was begun, by this machine's clock, and how the files of its recording begin."""

    begun: int
    stem: str


class Journal:
    """The file; written whole each time, so that a `kill -9` or a power cut finds the old one or the new one.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    sent : tuple of int, or None
        Place of the last letter that the broker has; None if there is none.
    runs : list of RecordedRun
        In the order in which they were begun.

    Raises
    ------
    StorageError
        If it cannot be read or written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.sent: Place | None = None
        self.runs: list[RecordedRun] = []
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
            self.runs = [RecordedRun(int(begun), str(stem)) for begun, stem in document["runs"]]
            if document["sent"] is not None:
                begun, index = document["sent"]
                self.sent = int(begun), int(index)
        except FileNotFoundError:
            pass
        except OSError as error:
            raise StorageError(f"{path}: cannot be read: {error.strerror}") from error
        except (ValueError, KeyError, TypeError) as error:
            raise StorageError(
                f"{path}: is no journal of what was sent ({error}); move it away to begin with none"
            ) from None

    def begin(self, stem: str) -> int:
        """Note a new run before anything of it is recorded; when it was begun."""
        begun = max([time.time_ns(), *(run.begun + 1 for run in self.runs)])
        self.runs = [*self.runs, RecordedRun(begun, stem)][-_RUNS:]
        self._write()
        return begun

    def note(self, sent: Place | None) -> None:
        """Note how far the broker has everything."""
        self.sent = sent
        self._write()

    def parts(self, run: RecordedRun) -> Sequence[Path]:
        """Files of a run's recording that are still there, in order."""
        folder = self._path.parent
        return sorted(p for p in folder.glob("*.mcap") if p.stem == run.stem or _is_part(p.stem, run.stem))

    def _write(self) -> None:
        document = {"sent": self.sent, "runs": [[run.begun, run.stem] for run in self.runs]}
        path = self._path.with_suffix(".new")
        try:
            with closing(WholeWrites(path, os.O_TRUNC)) as new:
                new.write(json.dumps(document).encode())
                new.sync()  # or a power cut could leave the name with nothing in it
                os.replace(path, self._path)
                new.sync_name()
        except OSError as error:
            raise StorageError(f"{self._path}: cannot be written: {error.strerror}") from error


def _is_part(stem: str, of: str) -> bool:
    return stem.startswith(f"{of}-") and stem[len(of) + 1 :].isdigit()
