"""Markdown tables on standard output, where `docs/figures.py measurements` reads them; details on standard error."""

from __future__ import annotations

import sys


def print_head(*names: str) -> None:
    """Prints the head of a table, after an empty line."""
    print()
    print_row(*names)
    print_row(*("---" for _ in names))


def print_row(*cells: object) -> None:
    """Prints a row of a table."""
    print("| " + " | ".join(map(str, cells)) + " |", flush=True)


def tell(text: str) -> None:
    """Prints a detail that is not part of a table."""
    print(text, file=sys.stderr, flush=True)
