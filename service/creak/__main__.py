"""``python -m creak``."""

from creak.cli import main

main()
