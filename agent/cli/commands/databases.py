"""The database as a file: check, repair, compact, copy."""

from pathlib import Path
from typing import Annotated

import typer

from agent.cli.commands.options import Database, Json

part = typer.Typer()


database = typer.Typer(help="Look after a database file.", no_args_is_help=True, rich_markup_mode=None)


part.add_typer(database, name="db")


@database.command("check")
def db_check(db: Database, json: Json = False) -> None:
    """Read a whole file and say what is wrong with it; it may be in use."""
    from agent.cli.tables import db as commands_db

    commands_db.check(db, as_json=json)


@database.command("repair")
def db_repair(db: Database, json: Json = False) -> None:
    """Replace a damaged file by one of every row that proves itself; the damaged one is kept beside it."""
    from agent.cli.tables import db as commands_db

    commands_db.repair(db, as_json=json)


@database.command("compact")
def db_compact(db: Database, json: Json = False) -> None:
    """Give the file's free pages back to the disk."""
    from agent.cli.tables import db as commands_db

    commands_db.compact(db, as_json=json)


@database.command("backup")
def db_backup(
    db: Database,
    target: Annotated[
        Path, typer.Argument(metavar="TARGET", help="The copy; must not exist.", show_default=False)
    ],
    json: Json = False,
) -> None:
    """Copy a file, also while an agent writes to it."""
    from agent.cli.tables import db as commands_db

    commands_db.backup(db, target, as_json=json)
