"""The command ``creak``."""

import io
import sys
from collections.abc import Sequence

import typer

from creak.cli.commands import Commands
from creak.errors import CreakError, InputError

# typer carries a click of its own and exports this one of its errors; what it derives from are all the others.
_UsageError: type[Exception] = typer.BadParameter.__bases__[0]

_INTERRUPTED = 130  # as a shell says of a command that Ctrl-C ended

app = typer.Typer(
    name="creak",
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)


@app.callback()
def creak() -> None:
    """Hears where a structure stops being linear."""


def run(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the process by default.

    Returns
    -------
    int
        0 done, 1 the run failed, 2 the user's input is wrong, 130 interrupted; what is wrong stands in one line on
        standard error.
    """
    try:
        code = app(args=arguments, standalone_mode=False)
    except _UsageError as error:
        line = _one_line(str(getattr(error, "format_message", error.__str__)()))
        return _say(line or "a command is missing; those above are allowed", 2)  # no line: help has been shown
    except InputError as error:
        return _say(_one_line(str(error)), 2)
    except CreakError as error:
        return _say(_one_line(str(error)), 1)
    except (KeyboardInterrupt, typer.Abort):
        return _say("interrupted", _INTERRUPTED)
    except MemoryError as error:
        return _say(_one_line(f"there is not enough memory: {error}".rstrip(": ")), 1)
    except BrokenPipeError:
        sys.stderr.close()  # whoever read our output has gone; there is nobody to tell
        return 1
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _say(_one_line(f"{where}{error.strerror or error}"), 1)
    except Exception as error:
        if _interrupted(error):
            return _say("interrupted", _INTERRUPTED)
        raise
    if code == _INTERRUPTED:  # typer's own answer to Ctrl-C, which says nothing
        return _say("interrupted", _INTERRUPTED)
    return code if isinstance(code, int) else 0


def main() -> None:
    """Entry point of the command."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal of ASCII shows no boxes, but must not end a command
    sys.exit(run())


def _interrupted(error: BaseException | None) -> bool:
    """True of an error that only follows from Ctrl-C, as those of a compiler stopped half-way."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__context__
    return False


def _say(line: str, code: int) -> int:
    sys.stderr.write(f"creak: {line}\n")
    return code


def _one_line(text: str) -> str:
    return " ".join(text.split())
