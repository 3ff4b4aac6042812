"""Every command, option, configuration key and view is in the documents, and links lead somewhere."""

import re
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import typer
from pydantic import BaseModel

from agent.cli.app import app
from agent.config import tables
from agent.config.load import RESERVED
from agent.storage.write.store import Store
from agent.types import Reason
from tests.docs.documents import links
from tests.peers import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
CONFIGURATION = (ROOT / "docs/configuration.md").read_text(encoding="utf-8")
DATABASE = (ROOT / "docs/database.md").read_text(encoding="utf-8")
COMMANDS: Any = typer.main.get_command(app)
NAMES = COMMANDS.list_commands(None)
NOT_KEYS = {"file", "sha256", "settings", "names", "covariate", "covariate_source"}


def documented(text: str) -> set[str]:
    """Return the words that stand in code quotes."""
    return {
        word
        for code in re.findall(r"`([^`\n]+)`", text)
        for word in re.findall(r"[A-Za-z_][A-Za-z0-9_]*", code)
    }


@pytest.mark.parametrize("name", NAMES)
def test_every_command_and_option_is_in_the_readme(name: str) -> None:
    (row,) = [line for line in README.splitlines() if line.startswith(f"| `deltak {name}")]
    command = COMMANDS.get_command(None, name)
    options = [p for p in command.params if p.param_type_name == "option" and not getattr(p, "hidden", False)]
    missing = [
        option.opts[-1]
        for option in options
        if f"`{option.opts[-1]}`" not in row and "--help" not in option.opts
    ]
    assert missing == []


def test_readme_tells_every_exit_code() -> None:
    assert set(re.findall(r"^\| (\d+) \|", README, re.MULTILINE)) == {"0", "1", "2", "3", "4", "130"}


def own_tables() -> list[type[BaseModel]]:
    found = [
        item for item in vars(tables).values() if isinstance(item, type) and issubclass(item, tables.Table)
    ]
    return [table for table in found if table not in (tables.Table, tables.RigConfig)]


@pytest.mark.parametrize("table", own_tables(), ids=lambda table: table.__name__)
def test_every_configuration_key_is_documented(table: type[BaseModel]) -> None:
    assert set(table.model_fields) - NOT_KEYS - documented(CONFIGURATION) == set()


@pytest.mark.parametrize("name", [*tables.RigConfig.model_fields, *RESERVED])
def test_every_configuration_table_is_documented(name: str) -> None:
    assert name in NOT_KEYS or f"[{name}" in CONFIGURATION or f"`{name}`" in CONFIGURATION


def is_there(point: EntryPoint) -> bool:
    """Tell whether a driver can come from a configuration (`replay` makes its own) and its module exists."""
    return point.name != "recording" and find_spec(point.module) is not None


def chapter(driver: str) -> str:
    return CONFIGURATION.partition(f'### driver = "{driver}"')[2].partition("\n##")[0]


@pytest.mark.parametrize(
    "driver", [point.name for point in entry_points(group="deltak.drivers") if is_there(point)]
)
def test_every_key_of_a_driver_is_documented(driver: str) -> None:
    (point,) = entry_points(group="deltak.drivers", name=driver)
    schema = point.load().settings_model.model_json_schema()
    keys = {key for part in (schema, *schema.get("$defs", {}).values()) for key in part.get("properties", ())}
    assert keys - documented(chapter(driver)) == set()


def columns_told(view: str) -> set[str]:
    """Return the columns that the table of views names; `as ...` stands for those of v_estimates."""
    (row,) = [line for line in DATABASE.splitlines() if line.startswith(f"| `{view}` |")]
    cell = row.split("|")[3]
    reported = documented(cell) - {"v_estimates"}
    return reported | columns_told("v_estimates") if cell.strip().startswith("as ") else reported


def test_every_view_and_column_is_documented(tmp_path: Path) -> None:
    with Store.open(tmp_path / "empty.db") as store:
        views = [
            name for (name,) in store.connection.execute("SELECT name FROM sqlite_master WHERE type = 'view'")
        ]
        for view in views:
            assert {
                column[1] for column in store.connection.execute(f"PRAGMA table_info({view})")
            } == columns_told(view)


@pytest.mark.parametrize("reason", [reason for reason in Reason if reason])
def test_every_reason_is_documented(reason: Reason) -> None:
    assert f"`{reason.name.lower().replace('_', ' ')}`" in DATABASE


def test_links_lead_somewhere() -> None:
    assert [(file.name, target) for file, target in links() if not (file.parent / target).exists()] == []
