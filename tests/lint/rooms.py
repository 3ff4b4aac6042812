"""Import graph of the whole: `python -m tests.lint.rooms` prints its rooms, their floors and its arrows up.

A room is a package; its floor is the files that stand in it directly. An arrow up goes against the order in
which rooms and files can be built, one after another, each from those before: without a circle there is none.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import grimp

from tests.lint.density import PACKAGES
from tests.peers import ROOT

Graph = Mapping[str, set[str]]


def modules() -> Graph:
    """Return what each module imports of the product."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    return {name: set(graph.find_modules_directly_imported_by(name)) for name in graph.modules}


def floors() -> dict[str, int]:
    """Return how many files stand in each package, but for the one that names it."""
    files = (
        file for package in PACKAGES for file in (ROOT / package).rglob("*.py") if file.stem != "__init__"
    )
    return dict(Counter(".".join(file.relative_to(ROOT).parent.parts) for file in files))


def rooms(graph: Graph, depth: int) -> Graph:
    """Return which rooms, named to a depth, import which others.

    Files beside whole rooms are rooms too, and so are tables of tuned numbers, which import nothing.
    """
    packages = {name for name in graph if (ROOT / Path(*name.split("."))).is_dir()}
    found: dict[str, set[str]] = {}
    for name, imported in graph.items():
        here = _room(name, packages, depth)
        found.setdefault(here, set()).update(_room(other, packages, depth) for other in imported)
    return {room: others - {room} for room, others in found.items()}


def _room(name: str, packages: set[str], depth: int) -> str:
    package = name if name in packages else name.rpartition(".")[0]
    is_apart = package in PACKAGES or name.endswith(".tuning")
    return name if is_apart else ".".join(package.split(".")[:depth])


def circles(graph: Graph) -> list[list[str]]:
    """Return the sets of nodes, more than one, each of which is reached from every other of its set (Tarjan
    1972)."""
    return [sorted(found) for found in _components(graph) if len(found) > 1]


def _components(graph: Graph) -> Iterator[set[str]]:
    reached = {name: _reached(graph, name) for name in graph}
    left = set(graph)
    while left:
        name = min(left)
        together = {other for other in reached[name] if name in reached.get(other, ())} | {name}
        left -= together
        yield together


def _reached(graph: Graph, start: str) -> set[str]:
    found: set[str] = set()
    waiting = [start]
    while waiting:
        for other in graph.get(waiting.pop(), set()) - found:
            found.add(other)
            waiting.append(other)
    return found


def main() -> None:
    """Print the rooms with the files on their floors and the rooms that they import; then circles."""
    graph = modules()
    for room, others in sorted(rooms(graph, 3).items()):
        print(f"{floors().get(room, 0):3} {room:32} -> {', '.join(sorted(others)) or '-'}")
    print(f"{len(graph)} modules, {sum(map(len, graph.values()))} imports")
    print("circles of modules:", circles(graph) or "none")
    print("circles of rooms:", circles(rooms(graph, 2)) or "none")
    print("circles of rooms within rooms:", circles(rooms(graph, 3)) or "none")


if __name__ == "__main__":
    main()
