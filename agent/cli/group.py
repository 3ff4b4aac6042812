"""The command group: built-in commands, and plug-ins that are loaded only when they are chosen."""

import ast
import select
import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperGroup

from agent.cli.terminal.streams import ReaderGoneError
from agent.cli.tuning import SUMMARY_LETTERS
from agent.errors import AgentError

GROUP = "deltak.commands"


class CommandGroup(TyperGroup):
    """Commands of this package, then those that entry points of the group `deltak.commands` name.

    A plug-in is a plain annotated function. Listing the commands imports none of them; one that cannot be
    imported fails alone, when it is called.
    """

    def list_commands(self, ctx: Any) -> list[str]:
        """Return all names: the built-in ones in their order, then the plug-ins' in the alphabet's."""
        return [*super().list_commands(ctx), *sorted(self._plugins())]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command by name, importing it where it is a plug-in."""
        built_in = super().get_command(ctx, cmd_name)
        plugin = None if built_in is not None else self._plugins().get(cmd_name)
        return built_in if plugin is None else _load(plugin)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; tell a reader of stdout that left from every other broken pipe."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError as error:
            if _reader_gone():
                raise ReaderGoneError from error
            raise RuntimeError(f"a pipe that is not stdout broke: {error}") from error

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the names with one line each, under the titles of their sections."""
        sections: dict[str, list[tuple[str, str]]] = {}
        for name, command in self.commands.items():
            title = getattr(command, "rich_help_panel", None) or "Commands"
            sections.setdefault(title, []).append((name, command.get_short_help_str(limit=SUMMARY_LETTERS)))
        plugins = [(name, _summary(plugin)) for name, plugin in sorted(self._plugins().items())]
        for title, rows in (*sections.items(), ("Plug-ins", plugins)):
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)

    def _plugins(self) -> dict[str, EntryPoint]:
        return {point.name: point for point in entry_points(group=GROUP) if point.name not in self.commands}


def _reader_gone() -> bool:
    """Tell whether nobody can read stdout any more."""
    poll = select.poll()
    poll.register(sys.stdout.fileno(), 0)
    return any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))


def _load(plugin: EntryPoint) -> Any:
    """Import a plug-in and make its command. Raises AgentError, whatever the plug-in raises."""
    try:
        function = plugin.load()
        single = typer.Typer(add_completion=False, rich_markup_mode=None)
        single.command(plugin.name)(function)
        return typer.main.get_command(single)
    except Exception as error:
        what = f"cannot be loaded from {plugin.value}: {type(error).__name__}: {error}"
        raise AgentError.at(plugin.name, what, f"update or remove {_origin(plugin)}") from error


def _summary(plugin: EntryPoint) -> str:
    """Return the first line of a plug-in's docstring without importing it, else where it comes from."""
    for source in _sources(plugin):
        try:
            tree = ast.parse(source.read_text(encoding="utf-8"))
        except (OSError, ValueError, SyntaxError):
            continue
        for node in tree.body:
            if isinstance(node, ast.FunctionDef) and node.name == plugin.attr and ast.get_docstring(node):
                return str(ast.get_docstring(node)).splitlines()[0]
    return f"from {_origin(plugin)}"


def _sources(plugin: EntryPoint) -> Iterator[Path]:
    """Yield the files that may hold a plug-in's function; finding a top-level package imports nothing."""
    top, *rest = plugin.module.split(".")
    try:
        spec = find_spec(top)
    except (ImportError, ValueError):
        return
    if spec is None:
        return
    for folder in spec.submodule_search_locations or []:
        yield Path(folder, *rest).with_suffix(".py") if rest else Path(folder, "__init__.py")
        yield Path(folder, *rest, "__init__.py")
    if spec.origin is not None and not rest:
        yield Path(spec.origin)


def _origin(plugin: EntryPoint) -> str:
    return plugin.dist.name if plugin.dist is not None else plugin.value
