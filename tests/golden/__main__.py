"""Write the golden outputs anew: `make golden`, or `python -m tests.golden step emps` for those of some
names."""

import os
import sys

from agent.kernels import settled

os.environ.update(settled())

from tests.golden.cases import Case, cases
from tests.golden.text import machine


def _write(case: Case) -> str:
    try:
        found = case.make()
    except BaseException as error:
        # a skip is pytest's way to say that data are missing
        if type(error).__name__ != "Skipped":
            raise
        return f"{case}: not written, {error}"
    case.file.parent.mkdir(exist_ok=True)
    text = "\n".join([f"# {machine()}", *found]) + "\n"
    same = case.file.exists() and case.file.read_text(encoding="utf-8") == text
    case.file.write_text(text, encoding="utf-8")
    return f"{case}: {'as it was' if same else 'written anew'}"


def main() -> None:
    """Write all, or those whose names are given."""
    asked = set(sys.argv[1:])
    for case in cases():
        if not asked or case.name in asked:
            print(_write(case), flush=True)  # noqa: T201 (a tool for the developer's terminal)


main()
