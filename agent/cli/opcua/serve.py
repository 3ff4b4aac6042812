"""`deltak opcua`: what is served, until it is stopped."""

import asyncio
import logging
from collections.abc import Sequence
from pathlib import Path

from agent.cli.glance.files import Watched, several
from agent.cli.opcua.access import Options, add_user, check, read_users
from agent.errors import UsageError
from agent.storage.read import queries

__all__ = ["Options", "add_user", "serve"]


def serve(targets: Sequence[Path], options: Options) -> None:
    """Answer OPC UA clients until SIGINT or SIGTERM.

    Raises:
        UsageError: without the extra `opcua`, for an address that needs users and a certificate, or one that
            cannot be used; ConfigError, StoreError: a configuration or a database that cannot be read.
    """
    try:
        import asyncua
    except ImportError as error:
        raise UsageError.at(
            "opcua", f"needs the extra opcua ({error})", "pip install 'deltak[opcua]'"
        ) from error
    del asyncua
    from agent.cli.opcua.server import until_stopped

    if not logging.getLogger().isEnabledFor(logging.INFO):
        # what clients do wrong is answered to them, not logged
        logging.getLogger("asyncua").setLevel(logging.CRITICAL)
    watched = _watched(targets)
    users = read_users(options.users) if options.users is not None else {}
    check(options, users)
    asyncio.run(until_stopped(watched, options, users))


def _watched(targets: Sequence[Path]) -> list[Watched]:
    """Return the databases named, or named by configurations. Raises UsageError, ConfigError, StoreError."""
    if not targets:
        raise UsageError.at("opcua", "no database is named", "give databases or configurations")
    databases = [target for target in targets if not (target.suffix == ".toml" or target.is_dir())]
    found = several(databases, [target for target in targets if target not in databases])
    for database in found:
        queries.rigs(database.path)  # says at once what is wrong with it
    return found
