"""``python -m creak.cli``."""

from creak.cli import main

main()
