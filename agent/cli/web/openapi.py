"""The description of the API in the form of OpenAPI 3.1, made of the table that answers it."""

from collections.abc import Mapping
from typing import Any, Final

from agent import __version__
from agent.cli.web.documents import DOCUMENTS, PARAMETERS, Document
from agent.cli.web.operate import CAUSES

_JSON: Final = {"application/json": {"schema": {"type": "object"}}}
_REFUSED: Final = {"description": "What is wrong: {errors: [{path, message, advice}]}.", "content": _JSON}


def openapi() -> dict[str, Any]:
    """Return the document."""
    paths = {f"/api/v1/{name}": {"get": _question(name, found)} for name, found in DOCUMENTS.items()}
    return {
        "openapi": "3.1.0",
        "info": {"title": "deltak", "version": __version__, "description": "Read-only without a session."},
        "paths": {**paths, "/api/v1/events": {"get": _events()}, "/api/v1/session": _session(), **_actions()},
    }


def _question(name: str, found: Document) -> Mapping[str, Any]:
    parameters = [
        {"name": key, "in": "query", "description": PARAMETERS[key], "schema": {"type": "string"}}
        for key in found.takes
    ]
    answers = {
        "200": {"description": "The document.", "content": _JSON},
        "304": {"description": "As its ETag says."},
    }
    return _operation(
        name, found.summary, {**answers, "400": _REFUSED, "409": _REFUSED}, parameters=parameters
    )


def _operation(name: str, summary: str, responses: Mapping[str, Any], **more: Any) -> dict[str, Any]:
    return {"operationId": name, "summary": summary, "responses": dict(responses), **more}


def _events() -> Mapping[str, Any]:
    summary = (
        "Server-sent events: hello, alarm, estimates, reset (read all anew); "
        "Last-Event-ID goes on without a gap."
    )
    header = {"name": "Last-Event-ID", "in": "header", "schema": {"type": "string"}}
    stream = {"description": "Events.", "content": {"text/event-stream": {"schema": {"type": "string"}}}}
    return _operation("events", summary, {"200": stream, "429": _REFUSED}, parameters=[header])


def _session() -> Mapping[str, Any]:
    done = {"200": {"description": "{signed_in, name, csrf, possible}", "content": _JSON}}
    refused = {"401": _REFUSED, "403": _REFUSED}
    return {
        "get": _operation("session", "Whether there is a session.", done),
        "post": _operation(
            "sign_in",
            "Open a session: {name, password}.",
            {**done, **refused, "429": _REFUSED},
            requestBody=_body(),
        ),
        "delete": _operation("sign_out", "Close the session.", {**done, **refused}),
    }


def _actions() -> Mapping[str, Any]:
    places = [
        {"name": "db", "in": "path", "required": True, "schema": {"type": "string"}},
        {"name": "alarm", "in": "path", "required": True, "schema": {"type": "integer"}},
        {"name": "X-CSRF-Token", "in": "header", "required": True, "schema": {"type": "string"}},
    ]
    answers = {"200": {"description": "What the agent did.", "content": _JSON}}
    answers |= dict.fromkeys(("400", "401", "403", "409"), _REFUSED)
    return {
        f"/api/v1/alarms/{{db}}/{{alarm}}/{action}": {
            "post": _operation(
                action,
                f"Ask the agent to {cause}: {{comment, for}}.",
                answers,
                parameters=places,
                requestBody=_body(),
            )
        }
        for action, cause in CAUSES.items()
    }


def _body() -> Mapping[str, Any]:
    return {"required": True, "content": _JSON}
