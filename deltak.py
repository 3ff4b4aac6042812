"""The first lines of the command `deltak`: are `agent`, `drivers` and `sim_bus` deltak's own?

Other distributions may use these names of import packages too, and pip writes one over the other without a
word. So this file, whose name is nobody else's, looks before any of them is imported.
"""

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import NoReturn

PACKAGES = ("agent", "drivers", "sim_bus")
ADVICE = "install deltak into an environment of its own, and unset PYTHONPATH"


def foreign_packages() -> list[str]:
    """Return in words which of the packages would be another's: found elsewhere first, or written over."""
    beside = Path(__file__).resolve().parent
    return [words for name in PACKAGES if (words := _foreign(name, beside / name / "__init__.py"))]


def _foreign(name: str, own: Path) -> str:
    spec = find_spec(name)
    if spec is None or spec.origin is None:
        return f"{name}: there is no such package in {own.parent.parent}"
    if Path(spec.origin).resolve() != own:
        return f"{name}: {spec.origin} comes before deltak's own package"
    if b"deltak's" not in own.read_bytes():
        return f"{name}: {own} is not deltak's: another distribution wrote over it"
    return ""


def main() -> NoReturn:
    """Run the command line, where its packages are its own; else say which is not, exit code 1."""
    foreign = foreign_packages()
    if foreign:
        sys.stderr.writelines(f"deltak: error: {words}; {ADVICE}\n" for words in foreign)
        sys.exit(1)
    from agent.cli.entry import main as command_line

    command_line()


if __name__ == "__main__":
    main()
