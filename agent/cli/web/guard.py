"""What holds for every request and answer: hosts, headers confining the page, errors that are documents."""

import asyncio
import logging
from collections.abc import Iterable, MutableMapping
from typing import Any, Final

from starlette.responses import JSONResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from agent.cli.terminal.output import fault_document
from agent.cli.tuning import PATIENCE_S
from agent.errors import AgentError, StoreError, UsageError

log = logging.getLogger(__name__)
POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
    "form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
)
HEADERS: Final = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=()",
}


def document(status: int, content: Any, headers: MutableMapping[str, str] | None = None) -> Response:
    """Return an answer of JSON that nobody keeps."""
    return JSONResponse(content, status, {"cache-control": "no-store", **(headers or {})})


def refusal(status: int, path: str, message: str, advice: str = "") -> Response:
    """Return an answer that says what is wrong, in the words and form of the command line."""
    return document(status, {"errors": [{"path": path, "message": message, "advice": advice}]})


def of_error(error: AgentError) -> Response:
    """Return the answer to what cannot be done: 400 for nonsense, 409 for what the database refuses."""
    status = 400 if isinstance(error, UsageError) else 409 if isinstance(error, StoreError) else 500
    errors = [fault_document(fault) for fault in error.faults]
    # by the names of the address, not those of the command line's options
    named = [{**one, "path": one["path"].removeprefix("--")} for one in errors]
    return document(status, {"errors": named})


class Guard:
    """The outermost layer: refuses foreign hosts, adds headers, and turns the unforeseen into a plain answer.

    Args:
        inner: the application.
        hosts: names under which the server may be asked, without ports; a page of another name that a
            resolver turned to this address (DNS rebinding) is refused by it. None for any, where a session is
            needed all the same.
    """

    def __init__(self, inner: ASGIApp, hosts: Iterable[str] | None) -> None:
        self._inner = inner
        self._hosts = None if hosts is None else frozenset(hosts)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._inner(scope, receive, send)
            return
        begun = False

        async def send_guarded(message: Message) -> None:
            nonlocal begun
            if message["type"] == "http.response.start":
                begun = True
                own = [(name.encode(), value.encode()) for name, value in HEADERS.items()]
                message = {**message, "headers": [*message.get("headers", ()), *own]}
            await asyncio.wait_for(send(message), PATIENCE_S)

        if not self._is_host(scope):
            answer = refusal(
                421, "host", "this server does not go by that name", "see deltak serve --hostname"
            )
            await answer(scope, receive, send_guarded)
            return
        try:
            await self._inner(scope, receive, send_guarded)
        except TimeoutError:
            log.info("an answer was not read within %g s and is given up", PATIENCE_S)
        except Exception as error:
            log.exception("a request could not be answered: %s", type(error).__name__)
            if begun:
                raise
            await refusal(500, "", "unforeseen", "see the log of deltak serve")(scope, receive, send_guarded)

    def _is_host(self, scope: Scope) -> bool:
        if self._hosts is None:
            return True
        said = next((value.decode("latin-1") for name, value in scope["headers"] if name == b"host"), "")
        name = said[: said.rfind("]") + 1] if said.startswith("[") else said.partition(":")[0]
        return name.lower() in self._hosts
