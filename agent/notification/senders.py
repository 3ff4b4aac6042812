"""How a message reaches a target. Each returns once the target has it, and raises SendError where it may not.

A target that hangs is left after the target's timeout_s; whether it took the message is then not known, and
the next attempt carries the same key.
"""

import base64
import json
import logging
import os
import re
import signal
import smtplib
import ssl
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping
from contextlib import suppress
from email.message import EmailMessage
from email.utils import formatdate
from http.client import HTTPException, InvalidURL
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from agent import __version__
from agent.config.reading.secrets import Secret
from agent.config.sections.results import Notify
from agent.notification.message import Message
from agent.notification.tuning import LEAST_SECRET

_QUOTING: Final = ("apprise", "requests", "urllib3")
"""Libraries whose logs quote addresses, and so the tokens in them, at any level."""
_PORTS: Final = {"starttls": 587, "tls": 465, "none": 25}


class SendError(Exception):
    """A message may not have reached its target; another attempt can help."""


def send(target: Notify, message: Message, folder: Path) -> None:
    """Bring a message to a target. Raises SendError.

    folder: where the configuration's relative paths start.
    """
    try:
        _SENDERS[target.kind](target, message, folder)
    except SendError as error:
        raise SendError(_without_secrets(str(error), target, folder)) from None
    except KeyError as error:
        raise SendError(f"the environment variable {error.args[0]} with the secret is not set") from error
    except (OSError, HTTPException, smtplib.SMTPException, ValueError) as error:
        raise SendError(_without_secrets(_words_of(error), target, folder)) from None


def _without_secrets(words: str, target: Notify, folder: Path) -> str:
    """Return words without the secrets that a target was shown, should it have said them."""
    for secret in (target.url, target.token, target.password):
        if isinstance(secret, Secret):
            with suppress(OSError, KeyError, ValueError):
                for form in _forms(_secret(secret, folder), target.user or ""):
                    words = words.replace(form, "***")
    return words


def _forms(secret: str, user: str) -> list[str]:
    """Return how a secret may come back: whole, as a mail server gets it, or in parts of an address."""
    coded = [base64.b64encode(text.encode()).decode() for text in (secret, f"\0{user}\0{secret}")]
    parts = [part for part in re.split(r"[/?&=#@:]+", secret) if len(part) >= LEAST_SECRET]
    return [form for form in (secret, *coded, *parts) if form]


def _words_of(error: Exception) -> str:
    """Return what went wrong; of what refuses an address or a header, which it quotes, not what was in it."""
    is_quoting = isinstance(error, InvalidURL) or not isinstance(error, OSError | HTTPException)
    words = "its url or its secret holds what none may" if is_quoting else str(error)
    return f"{type(error).__name__}: {words}" if words else type(error).__name__


def _secret(secret: Secret | str | None, folder: Path) -> str:
    return secret.read(folder, dict(os.environ)) if isinstance(secret, Secret) else secret or ""


def _command(target: Notify, message: Message, folder: Path) -> None:
    """Start a program with the document on its standard input; it has the message when it exits with 0."""
    said = {
        f"DELTAK_{name.upper()}": str(value) for name, value in message.document.items() if _is_plain(value)
    }
    environment = {
        **os.environ,
        **said,
        "DELTAK_IDEMPOTENCY_KEY": message.key,
        "DELTAK_SUBJECT": message.subject,
    }
    with subprocess.Popen(
        target.command or (), stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        cwd=folder,
        env={name: value.replace("\0", "") for name, value in environment.items()}, start_new_session=True,
    ) as process:  # fmt: skip
        try:
            _, complaint = process.communicate(
                json.dumps(message.document).encode(), timeout=target.timeout_s
            )
        except subprocess.TimeoutExpired as error:
            os.killpg(process.pid, signal.SIGKILL)
            raise SendError(f"did not end within {target.timeout_s:g} s") from error
    if process.returncode != 0:
        raise SendError(f"exit code {process.returncode}: {complaint.decode(errors='replace').strip()}")


def _is_plain(value: Any) -> bool:
    return value is not None and not isinstance(value, Mapping)


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Another address would be asked without the document: a redirection is an error."""

    def redirect_request(self, *_: Any) -> None:
        return None


_OPENER: Final = urllib.request.build_opener(_NoRedirect)


def _webhook(target: Notify, message: Message, folder: Path) -> None:
    """POST the document as JSON; any answer of the 200s says that it is there."""
    url = _secret(target.url, folder)
    if urlsplit(url).scheme not in {"http", "https"}:
        raise SendError("its url is no http or https address")
    agent = f"deltak/{__version__}"
    headers = {"Content-Type": "application/json", "Idempotency-Key": message.key, "User-Agent": agent}
    if target.token is not None:
        headers["Authorization"] = f"Bearer {_secret(target.token, folder)}"
    request = urllib.request.Request(url, json.dumps(message.document).encode(), headers, method="POST")  # noqa: S310 - the scheme was looked at
    try:
        with _OPENER.open(request, timeout=target.timeout_s) as answer, suppress(OSError, HTTPException):
            _drain(answer.read1, time.monotonic() + target.timeout_s)
    except urllib.error.HTTPError as error:
        with error:
            raise SendError(f"answered {error.code} {error.reason}") from error


def _drain(read: Callable[[int], bytes], until: float) -> None:
    """Read an answer that nobody needs, a little of it, so that who sends it sees no broken pipe."""
    for _ in range(16):
        if time.monotonic() > until or not read(4096):
            return


def _smtp(target: Notify, message: Message, folder: Path) -> None:
    """Hand a mail to a server; it has it when it says so after the data."""
    port = target.port or _PORTS[target.tls]
    context = ssl.create_default_context()
    connection: smtplib.SMTP
    if target.tls == "tls":
        connection = smtplib.SMTP_SSL(target.host or "", port, timeout=target.timeout_s, context=context)
    else:
        connection = smtplib.SMTP(target.host or "", port, timeout=target.timeout_s)
    try:
        if target.tls == "starttls":
            connection.starttls(context=context)
        if target.user is not None:
            connection.login(target.user, _secret(target.password, folder))
        refused = connection.send_message(_mail(target, message))
        if refused:
            raise SendError(f"refused for {', '.join(refused)}")
    finally:
        connection.close()  # no QUIT: its answer may be lost when the mail is there


def _mail(target: Notify, message: Message) -> EmailMessage:
    mail = EmailMessage()
    mail["Message-ID"] = f"<{message.key}@deltak>"
    mail["Date"] = formatdate(message.document["t_ns"] / 1e9, localtime=True)
    mail["Subject"] = message.subject
    mail["From"] = target.sender or ""
    mail["To"] = ", ".join(target.recipients or ())
    mail.set_content(message.text)
    return mail


def _apprise(target: Notify, message: Message, folder: Path) -> None:
    """Hand the text to a service that apprise knows by its address; it says yes or no, and takes no key."""
    try:
        from apprise import Apprise
    except ImportError as error:
        raise SendError('needs apprise: pip install "deltak[apprise]"') from error
    for library in _QUOTING:
        logging.getLogger(library).setLevel(logging.CRITICAL + 1)
    services = Apprise()
    if not services.add(_secret(target.url, folder)):
        raise SendError("its url is none that apprise knows")
    if not services.notify(body=message.text, title=message.subject):
        raise SendError("apprise could not deliver it")


_SENDERS: Final[Mapping[str, Callable[[Notify, Message, Path], None]]] = {
    "command": _command, "webhook": _webhook, "smtp": _smtp, "apprise": _apprise,
}  # fmt: skip
