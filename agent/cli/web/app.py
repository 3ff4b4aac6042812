"""The application: which address is answered by what."""

import asyncio
import json
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Final

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp

from agent.cli.glance.files import Watched
from agent.cli.terminal.output import json_ready
from agent.cli.tuning import MOST_LISTENERS
from agent.cli.web.answers import Answers, tagged
from agent.cli.web.guard import Guard, refusal
from agent.cli.web.openapi import openapi
from agent.cli.web.secret import Secret
from agent.cli.web.stream import Event, Hub, Position
from agent.cli.web.writes import Writes

_TYPES: Final = {
    ".html": "text/html; charset=utf-8", ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8", ".svg": "image/svg+xml", ".txt": "text/plain; charset=utf-8",
}  # fmt: skip
_OPEN_PATHS: Final = ("/", "/static", "/api/v1/session")
"""What is answered without a session where reading needs one too: the page itself, and signing in."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What a server is: databases, the session secret, whether reading needs one too, names it goes by."""

    watched: tuple[Watched, ...]
    secret: Secret | None = None
    private: bool = False
    hosts: frozenset[str] | None = None


def application(settings: Settings) -> ASGIApp:
    """Return the ASGI application."""
    hub = Hub([database.path for database in settings.watched])
    writes = Writes(settings.watched, settings.secret)

    @asynccontextmanager
    async def living(_app: Starlette) -> AsyncIterator[None]:
        task = asyncio.create_task(hub.run())
        yield
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task

    inner = Starlette(
        routes=_routes(settings, hub, writes),
        lifespan=living,
        exception_handlers={404: _absent, 405: _absent},
    )
    return Guard(_private(inner, writes) if settings.private else inner, settings.hosts)


def _routes(settings: Settings, hub: Hub, writes: Writes) -> list[Route]:
    static = _static()
    described = json.dumps(openapi()).encode()

    async def page(request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        if name not in static:
            return refusal(404, name, "there is no such file")
        body, kind = static[name]
        return tagged(request, body, kind)

    async def description(request: Request) -> Response:
        return tagged(request, described, "application/json")

    async def events(request: Request) -> Response:
        return await _events(request, hub, [database.name for database in settings.watched])

    return [
        Route("/", page),
        Route("/static/{name}", page),
        Route("/api/v1/openapi.json", description),
        Route("/api/v1/events", events),
        Route("/api/v1/session", writes.who),
        Route("/api/v1/session", writes.sign_in, methods=["POST"]),
        Route("/api/v1/session", writes.sign_out, methods=["DELETE"]),
        Route("/api/v1/alarms/{db}/{alarm:int}/{action}", writes.act, methods=["POST"]),
        Route("/api/v1/{name}", Answers(settings.watched).answer),
    ]


def _static() -> Mapping[str, tuple[bytes, str]]:
    """Return the page's files by name with types; they are read once, nothing else can be asked for."""
    folder = files("agent.cli.web") / "static"
    found = ((file.name, file) for file in folder.iterdir())
    return {
        name: (file.read_bytes(), kind)
        for name, file in found
        if (kind := _TYPES.get(name[name.rfind(".") :])) is not None
    }


async def _absent(_request: Request, error: Exception) -> Response:
    status = int(getattr(error, "status_code", 404))
    return refusal(status, "address", "there is nothing to ask here in that way", "see /api/v1/openapi.json")


def _private(inner: ASGIApp, writes: Writes) -> ASGIApp:
    """Return the application with all that shows rows behind a session."""

    async def asked(scope: Any, receive: Any, send: Any) -> None:
        path = scope.get("path", "")
        is_open = scope["type"] != "http" or path in _OPEN_PATHS or path.startswith("/static/")
        if is_open or writes.session_of(Request(scope)) is not None:
            await inner(scope, receive, send)
            return
        await refusal(401, "session", "is needed to read here", "sign in")(scope, receive, send)

    return asked


async def _events(request: Request, hub: Hub, names: list[str]) -> Response:
    """Answer with a stream of server-sent events; Last-Event-ID, or `from`, is where it goes on."""
    if hub.listeners >= MOST_LISTENERS:
        return refusal(429, "events", f"{MOST_LISTENERS} listen already", "come again later")
    said = request.headers.get("last-event-id") or request.query_params.get("from") or ""
    position = Position.read(said[:1000], len(names)) if said else None
    is_unreadable = bool(said) and position is None
    following = hub.follow(position)
    first = await anext(following)
    if is_unreadable:
        first = Event("reset", first.position)

    async def lines() -> AsyncIterator[str]:
        hub.listeners += 1
        try:
            yield _line(first, names)
            async for event in following:
                yield _line(event, names)
        finally:
            hub.listeners -= 1

    headers = {"cache-control": "no-store", "x-accel-buffering": "no"}
    return StreamingResponse(lines(), 200, headers, "text/event-stream")


def _line(event: Event, names: list[str]) -> str:
    """Return an event as the stream carries it (HTML standard, section 9.2)."""
    if event.kind == "alive":
        return ": alive\n\n"
    content: Any = {}
    if event.change is not None:
        content = {**json_ready(event.change.document), "db": names[event.place]}
    text = json.dumps(content, allow_nan=False)
    return f"id: {event.position}\nevent: {event.kind}\ndata: {text}\n\n"
