"""Processes that show the database: a page, a terminal, OPC UA."""

from pathlib import Path
from typing import Annotated

import typer

part = typer.Typer()


@part.command()
def watch(
    target: Annotated[
        Path | None,
        typer.Argument(metavar="[CONFIG|DB]", help="The only *.db here without.", show_default=False),
    ] = None,
    once: Annotated[bool, typer.Option("--once", help="One frame, for scripts and pipes.")] = False,
) -> None:
    """Show at a glance, in the terminal: values against their limits, states, alarms, sources; q quits."""
    from agent.cli.glance import watch as commands_watch

    commands_watch.watch(target, once=once)


@part.command()
def serve(  # noqa: PLR0913, PLR0917 the signature is the command line
    db: Annotated[
        list[Path] | None, typer.Option("--db", metavar="DB", help="Database to show; may be repeated.")
    ] = None,
    config: Annotated[
        list[Path] | None,
        typer.Option("--config", metavar="CONFIG", help="Shows its database, limits and model."),
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 for a free one.")] = 8765,
    password_file: Annotated[
        Path | None,
        typer.Option("--password-file", metavar="FILE", help="Hash of the password for acknowledging."),
    ] = None,
    token_file: Annotated[
        Path | None, typer.Option("--token-file", metavar="FILE", help="A token instead of a password.")
    ] = None,
    private: Annotated[bool, typer.Option("--private", help="Reading needs the password too.")] = False,
    hostname: Annotated[
        list[str] | None, typer.Option("--hostname", metavar="NAME", help="A name that the server goes by.")
    ] = None,
    proxy: Annotated[
        str | None,
        typer.Option("--proxy", metavar="ADDRESS", help="The reverse proxy whose headers are believed."),
    ] = None,
    new_password: Annotated[
        Path | None,
        typer.Option("--new-password", metavar="FILE", help="Ask for a password, write its hash, stop."),
    ] = None,
) -> None:
    """Show the page and answer the HTTP API; a process of its own that only reads the databases."""
    from agent.cli.web import serve as commands_serve

    if new_password is not None:
        commands_serve.new_password(new_password)
        return
    options = commands_serve.Options(host, port, password_file, token_file, private, hostname or (), proxy)
    commands_serve.serve(db or [], config or [], options)


@part.command()
def opcua(  # noqa: PLR0913, PLR0917 the signature is the command line
    target: Annotated[
        list[Path] | None,
        typer.Argument(metavar="DB|CONFIG...", help="What to serve; a configuration its database."),
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 for a free one.")] = 4840,
    hostname: Annotated[
        str | None, typer.Option("--hostname", metavar="NAME", help="The name under which clients reach it.")
    ] = None,
    users: Annotated[
        Path | None,
        typer.Option("--users", metavar="FILE", help="Users that may act, with hashes of passwords."),
    ] = None,
    new_user: Annotated[
        str | None,
        typer.Option("--new-user", metavar="NAME", help="Ask for a password, add it to --users, stop."),
    ] = None,
    certificate: Annotated[
        Path | None,
        typer.Option("--certificate", metavar="FILE", help="The server's certificate, PEM or DER."),
    ] = None,
    key: Annotated[Path | None, typer.Option("--key", metavar="FILE", help="Its private key.")] = None,
    trusted: Annotated[
        Path | None,
        typer.Option("--trusted", metavar="FOLDER", help="Certificates of clients; others are refused."),
    ] = None,
    private: Annotated[bool, typer.Option("--private", help="Reading needs a user too.")] = False,
) -> None:
    """Serve parameters and alarms over OPC UA; a process of its own that only reads the databases."""
    from agent.cli.opcua import serve as commands_opcua

    if new_user is not None:
        commands_opcua.add_user(users, new_user)
        return
    options = commands_opcua.Options(host, port, hostname, users, certificate, key, trusted, private)
    commands_opcua.serve(target or [], options)
