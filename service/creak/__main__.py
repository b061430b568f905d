"""The command ``creak``, also as ``python -m creak``; Ctrl-C may come while its modules are still imported."""

import sys

_INTERRUPTED = 130


def main() -> None:
    """Entry point of the command."""
    try:
        from creak.cli import main as command

        command()
    except KeyboardInterrupt:
        sys.stderr.write("creak: interrupted\n")
        sys.exit(_INTERRUPTED)


if __name__ == "__main__":
    main()
