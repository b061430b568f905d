"""How every benchmark shows what it measured: a table for people, or one JSON document with --json."""

import argparse
import json

from rich.console import Console
from rich.table import Table


def options(description, **defaults):
    """The options of a benchmark: --json, and a number for each default."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--json", action="store_true", help="one JSON document instead of a table")
    for name, value in defaults.items():
        parser.add_argument(
            f"--{name.replace('_', '-')}", type=type(value), default=value, help=f"default {value}"
        )
    return parser.parse_args()


def show(title, rows, as_json, **more):
    """Rows are dictionaries with the same keys; the document holds `more` beside them."""
    if as_json:
        Console().print_json(json.dumps({"benchmark": title, "rows": rows, **more}))
        return
    table = Table(title=title, title_justify="left")
    for key in rows[0]:
        table.add_column(key)
    for row in rows:
        table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values()))
    Console().print(table)


def show_all(tables, as_json):
    """Several tables, ``{title: rows}``."""
    if as_json:
        Console().print_json(json.dumps({"tables": tables}))
        return
    for title, rows in tables.items():
        show(title, rows, False)
