"""Two and three effects at once, each well above noise, on cases whose truth the diagnosis does not see."""

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from figures import options, show

from blind import several, trial


def main():
    """Print the table."""
    given = options(__doc__.splitlines()[0], cases=40, seed=1, timeout=300.0)
    rows = []
    for count in (2, 3):
        marks = []
        for index in range(given.cases):
            with tempfile.TemporaryDirectory(prefix="creak-") as folder:
                result = trial.run(several.draw(given.seed, index, count), Path(folder), given.timeout)
            marks.append(several.score(result["truth"], result["answer"]))
        rows.append(
            {
                "effects": count,
                "cases": len(marks),
                "all found": sum(mark["all"] for mark in marks),
                "effects found": sum(mark["found"] for mark in marks),
                "cases with an invented one": sum(mark["invented"] > 0 for mark in marks),
                "waterfall falls": sum(mark["falling"] for mark in marks),
            }
        )
    show("Several effects at once", rows, given.json)


if __name__ == "__main__":
    main()
