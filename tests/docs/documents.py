"""The user's documents as the tests read them."""

import re
from dataclasses import dataclass
from pathlib import Path

from tests.peers import ROOT

FILES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))


@dataclass(frozen=True)
class Block:
    """A fenced block: where it stands, its language, its text."""

    file: Path
    line: int
    language: str
    text: str

    def __str__(self) -> str:
        return f"{self.file.name}:{self.line}"


def blocks(language: str) -> list[Block]:
    """Return the fenced blocks of a language, in order."""
    found = []
    for file in FILES:
        text = file.read_text(encoding="utf-8")
        for match in re.finditer(r"^```(\w+)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
            found.append(Block(file, text.count("\n", 0, match.start()) + 1, match[1], match[2]))  # noqa: PERF401 reads better
    return [block for block in found if block.language == language]


def links() -> list[tuple[Path, str]]:
    """Return the relative targets of links and pictures."""
    found = [
        (file, target)
        for file in FILES
        for target in re.findall(r"\]\(([^)#]+)", file.read_text(encoding="utf-8"))
    ]
    return [(file, target) for file, target in found if "://" not in target]
