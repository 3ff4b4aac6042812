"""Answers to questions: made once per state of a database, with an ETag by which nothing is sent twice."""

import asyncio
import hashlib
import json
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Any

from anyio.to_thread import run_sync
from starlette.requests import Request
from starlette.responses import Response

from agent.cli.glance.files import Watched
from agent.cli.tuning import ASKED_AT_ONCE, KEPT_ANSWERS, LONGEST_VALUE
from agent.cli.web.documents import DOCUMENTS, made
from agent.cli.web.guard import of_error, refusal
from agent.cli.web.stream import is_settled, stamp
from agent.clock import monotonic_ns
from agent.errors import AgentError

Key = tuple[str, tuple[tuple[str, str], ...]]


def tagged(request: Request, body: bytes, media_type: str) -> Response:
    """Return a body with its ETag; 304 and nothing where the asker has it already."""
    tag = f'"{hashlib.sha256(body).hexdigest()[:32]}"'
    headers = {"etag": tag, "cache-control": "no-cache"}
    known = {part.strip().removeprefix("W/") for part in request.headers.get("if-none-match", "").split(",")}
    if tag in known:
        return Response(None, 304, headers)
    return Response(body, 200, headers, media_type)


@dataclass(slots=True)
class Answers:
    """Documents of some databases; of each question the newest answer is kept until a commit makes it old."""

    watched: tuple[Watched, ...]
    _kept: OrderedDict[Key, tuple[Any, bytes]] = field(default_factory=OrderedDict)
    _gate: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(ASKED_AT_ONCE))

    async def answer(self, request: Request) -> Response:
        """Answer GET /api/v1/NAME?..."""
        name = request.path_params["name"]
        if name not in DOCUMENTS:
            return refusal(404, name, "there is no such document", "see /api/v1/openapi.json")
        strange = [key for key in request.query_params if key not in DOCUMENTS[name].takes]
        if strange:
            takes = ", ".join(DOCUMENTS[name].takes) or "nothing"
            return refusal(
                400, strange[0][:LONGEST_VALUE], f"is nothing that {name} can be asked", f"it takes {takes}"
            )
        if any(len(value) > LONGEST_VALUE for value in request.query_params.values()):
            return refusal(400, name, f"a value has more than {LONGEST_VALUE} characters", "shorten it")
        try:
            body = await self._body((name, tuple(sorted(request.query_params.items()))))
        except AgentError as error:
            return of_error(error)
        return tagged(request, body, "application/json")

    async def _body(self, key: Key) -> bytes:
        async with self._gate:
            state = self._state(key[0])
            found = self._kept.get(key)
            if found is None or found[0] != state:
                found = state, await run_sync(self._made, key)
                self._kept[key] = found
            self._kept.move_to_end(key)
            while len(self._kept) > KEPT_ANSWERS:
                self._kept.popitem(last=False)
        return found[1]

    def _state(self, name: str) -> Any:
        """Return what changes when an answer does: the files, and for some the second."""
        stamps = [stamp(database.path) for database in self.watched]
        if not all(map(is_settled, stamps)):
            return monotonic_ns()  # another one each time
        return monotonic_ns() // 1_000_000_000 if DOCUMENTS[name].by_clock else 0, *stamps

    def _made(self, key: Key) -> bytes:
        name, asked = key
        return json.dumps(made(name, self.watched, dict(asked)), allow_nan=False, ensure_ascii=False).encode()
