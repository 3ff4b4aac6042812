"""Requests that change something: signing in and out, and what an operator does to an alarm."""

import asyncio
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from anyio.to_thread import run_sync
from starlette.requests import Request
from starlette.responses import Response

from agent.cli.glance.files import Watched
from agent.cli.tuning import NAME_LETTERS, REQUEST_BYTES, SESSION_S
from agent.cli.web.guard import document, of_error, refusal
from agent.cli.web.operate import CAUSES, operate
from agent.cli.web.secret import Secret
from agent.cli.web.sessions import Attempts, Session, Sessions
from agent.errors import AgentError

COOKIE: Final = "deltak_session"


class _RefusedError(Exception):
    """A request that goes no further: status, path, message, advice."""


@dataclass(slots=True)
class Writes:
    """What may be changed over HTTP, and by whom."""

    watched: tuple[Watched, ...]
    secret: Secret | None
    sessions: Sessions = field(default_factory=Sessions)
    attempts: Attempts = field(default_factory=Attempts)
    _gate: asyncio.Lock = field(default_factory=asyncio.Lock)

    def session_of(self, request: Request) -> Session | None:
        """Return the session of whoever asks; None without one."""
        return self.sessions.find(request.cookies.get(COOKIE))

    async def who(self, request: Request) -> Response:
        """Answer GET /api/v1/session: whether there is one, its name and what its writes must bring along."""
        return document(200, _shown(self.session_of(request), possible=self.secret is not None))

    async def sign_in(self, request: Request) -> Response:
        """Answer POST /api/v1/session {"name", "password"}; 429 after 5 wrong ones a minute per address."""
        try:
            asked = await _object(request)
            name = _name(asked)
            password = asked.get("password")
            if self.secret is None:
                advice = "start deltak serve with --password-file or --token-file"
                raise _RefusedError(403, "session", "this server has no password", advice)
            if not isinstance(password, str):
                raise _RefusedError(400, "password", "is no text", "give it")
        except _RefusedError as refused:
            return refusal(*refused.args)
        return await self._tried(request, self.secret, name, password)

    async def _tried(self, request: Request, secret: Secret, name: str, password: str) -> Response:
        address = request.client.host if request.client is not None else ""
        async with self._gate:  # one try at a time: each takes memory and time on purpose
            wait_s = self.attempts.wait_s(address)
            if wait_s > 0.0:
                answer = refusal(429, "password", "was wrong too often", f"wait {math.ceil(wait_s)} s")
                answer.headers["retry-after"] = str(math.ceil(wait_s))
                return answer
            if not await run_sync(secret.is_known_by, password):
                self.attempts.fail(address)
                return refusal(401, "password", "is wrong", "")
        self.sessions.end(request.cookies.get(COOKIE))
        value, session = self.sessions.begin(name)
        answer = document(200, _shown(session, possible=True))
        answer.set_cookie(
            COOKIE,
            value,
            max_age=int(SESSION_S),
            httponly=True,
            samesite="strict",
            secure=request.url.scheme == "https",
        )
        return answer

    async def sign_out(self, request: Request) -> Response:
        """Answer DELETE /api/v1/session."""
        try:
            self._signed_in(request)
        except _RefusedError as refused:
            return refusal(*refused.args)
        self.sessions.end(request.cookies.get(COOKIE))
        answer = document(200, _shown(None, possible=True))
        answer.delete_cookie(COOKIE, httponly=True, samesite="strict")
        return answer

    async def act(self, request: Request) -> Response:
        """Answer POST /api/v1/alarms/DB/ID/ack, shelve and unshelve."""
        place = request.path_params
        try:
            session = self._signed_in(request)
            asked = await _object(request)
            database = next((d for d in self.watched if d.name == place["db"]), None)
            if database is None or place["action"] not in CAUSES or place["alarm"] >= 2**63:
                raise _RefusedError(
                    404, place["action"], "there is no such thing to do", "see /api/v1/openapi.json"
                )
            done = await run_sync(
                operate, database.path, place["action"], place["alarm"], session.name, asked
            )
        except _RefusedError as refused:
            return refusal(*refused.args)
        except AgentError as error:
            return of_error(error)
        return document(200, done)

    def _signed_in(self, request: Request) -> Session:
        """Return the session of a request that may write: its cookie is known, its token the session's."""
        session = self.session_of(request)
        if session is None:
            raise _RefusedError(401, "session", "is needed for that", "sign in")
        if request.headers.get("x-csrf-token", "") != session.csrf:
            raise _RefusedError(403, "x-csrf-token", "is not that of the session", "see GET /api/v1/session")
        return session


def _shown(session: Session | None, *, possible: bool) -> dict[str, Any]:
    known = session is not None
    return {
        "signed_in": known,
        "name": session.name if session is not None else None,
        "csrf": session.csrf if session is not None else None,
        "possible": possible,
    }


async def _object(request: Request) -> Mapping[str, Any]:
    """Return a request's object; types other than JSON, which a foreign form could send, are refused."""
    if request.headers.get("content-type", "").partition(";")[0].strip() != "application/json":
        raise _RefusedError(415, "content-type", "is not application/json", "send JSON")
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > REQUEST_BYTES:
            raise _RefusedError(413, "body", f"has more than {REQUEST_BYTES} bytes", "send less")
    try:
        found = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise _RefusedError(400, "body", "is no JSON", "send one object") from error
    if not isinstance(found, dict):
        raise _RefusedError(400, "body", "is no object", "send one object")
    return found


def _name(asked: Mapping[str, Any]) -> str:
    name = asked.get("name")
    if not isinstance(name, str) or not name.strip() or len(name) > NAME_LETTERS or not name.isprintable():
        raise _RefusedError(400, "name", f"is no name of 1 to {NAME_LETTERS} characters", "say who you are")
    return name.strip()
