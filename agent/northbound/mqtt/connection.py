"""One connection to an MQTT broker: what is published is waited for, and every failure has a cause.

The library's thread reads and writes; a broker that hangs, or is gone, is left after the consumer's timeout.
"""

import re
import socket
import ssl
import threading
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags, MQTTMessage, MQTTv5
from paho.mqtt.enums import CallbackAPIVersion, LogLevel, MQTTErrorCode
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from agent.config.sections.north import North
from agent.northbound.interface.certificate import refuse_expired
from agent.northbound.interface.peer import Credentials, PeerError, Place
from agent.northbound.tuning import LEAVE_S, LOOK_S, MESSAGES_AT_ONCE

_PORTS: Final = {"mqtt": 1883, "mqtts": 8883}
_CREDENTIALS: Final = {"Not authorized", "Bad user name or password", "Banned", "Bad authentication method"}
_WITH_WILL: Final = "Disconnect with will message"


class Connection:
    """A broker, yet to be connected to.

    Args:
        consumer: its table of the configuration.
        place: the agent around it.
        will: topic, payload, quality of service and retention of what the broker says when this connection is
            gone.
        on_message: gets topic and payload of what arrives, in the library's thread.
    """

    def __init__(
        self,
        consumer: North,
        place: Place,
        will: tuple[str, bytes, int, bool],
        on_message: Callable[[str, bytes], None] = lambda _topic, _payload: None,
    ) -> None:
        self._consumer, self._place = consumer, place
        self._changed = threading.Condition()
        self._answer: ReasonCode | None = None
        self._lost: str | None = None
        self._said = ""
        self._acknowledged: dict[int, ReasonCode | None] = {}
        self._confirmed: dict[int, ReasonCode | None] = {}
        self._awaited: set[int] = set()
        self._on_message = on_message
        self._client = Client(
            CallbackAPIVersion.VERSION2,
            client_id_of(consumer, place),
            protocol=MQTTv5,
            reconnect_on_failure=False,
        )
        self._client.will_set(*will)
        self._client.connect_timeout = consumer.timeout_s
        self._client.on_connect = self._connected
        self._client.on_disconnect = self._disconnected
        self._client.on_publish = self._published
        self._client.on_subscribe = self._subscribed
        self._client.on_message = self._arrived
        self._client.on_log = self._logged

    def open(self) -> None:
        """Connect, with a session of its own that ends with the connection. Raises PeerError."""
        address = urlsplit(str(self._consumer.url))
        host = str(address.hostname)
        credentials = Credentials.read(self._consumer, self._place.folder)
        self._client.username_pw_set(credentials.user, credentials.password)
        if address.scheme == "mqtts":
            self._client.tls_set_context(tls_context(self._consumer, self._place.folder))
        port = address.port or _PORTS[address.scheme]
        keepalive = max(2, round(self._consumer.timeout_s))
        try:
            self._client.connect(host, port, keepalive, clean_start=True)
        except (OSError, ValueError) as error:
            raise PeerError(cause_of(error), credentials.hidden(f"{host}:{port}: {error}")) from error
        self._client.loop_start()
        self.wait(lambda: self._answer is not None, "no answer to the connection")
        answer = self._answer
        if answer is not None and answer.is_failure:
            cause = "credentials" if str(answer) in _CREDENTIALS else "refused"
            raise PeerError(cause, f"{host}:{port}: the broker says: {answer}")

    def publish(self, topic: str, payload: bytes, *, qos: int = 1, retain: bool = False) -> int:
        """Hand a message to the library; return its number. Raises PeerError."""
        info = self._client.publish(topic, payload, qos, retain)
        if info.rc not in {MQTTErrorCode.MQTT_ERR_SUCCESS, MQTTErrorCode.MQTT_ERR_QUEUE_SIZE}:
            raise self._failure(f"publishing failed ({info.rc.name})")
        return int(info.mid)

    def acknowledged(self, numbers: set[int]) -> None:
        """Wait until the broker has acknowledged messages. Raises PeerError."""
        self._awaited = numbers
        self._need(numbers, self._acknowledged)

    def _need(self, numbers: set[int], said: dict[int, ReasonCode | None]) -> None:
        """Wait until the broker has said yes to what has these numbers. Raises PeerError."""
        self.wait(lambda: numbers <= said.keys(), "no acknowledgement")
        with self._changed:
            answers = [said.pop(number) for number in numbers]
        refused = [answer for answer in answers if answer is not None and answer.is_failure]
        if refused:
            cause = "full" if str(refused[0]) == "Quota exceeded" else "refused"
            raise PeerError(cause, f"the broker refuses messages: {refused[0]}")

    def subscribe(self, topic: str, *, retained: bool = False) -> None:
        """Subscribe, and wait for the answer: then the broker has all that was sent before. Raises PeerError.

        retained: whether what the broker holds of the topic is wanted.
        """
        handling = (
            SubscribeOptions.RETAIN_SEND_ON_SUBSCRIBE if retained else SubscribeOptions.RETAIN_DO_NOT_SEND
        )
        result, number = self._client.subscribe(
            topic, options=SubscribeOptions(qos=1, retainHandling=handling)
        )
        if result is not MQTTErrorCode.MQTT_ERR_SUCCESS or number is None:
            raise self._failure(f"subscribing failed ({result.name})")
        self._need({number}, self._confirmed)

    def wait(self, done: Callable[[], bool], words: str) -> None:
        """Wait until something is so, for as long as the consumer may take. Raises PeerError."""
        left = self._consumer.timeout_s
        while True:
            with self._changed:
                if self._changed.wait_for(lambda: done() or self._lost is not None, LOOK_S):
                    break
            left -= LOOK_S
            if not self._place.waiting():
                raise PeerError("stopped", "the agent is ending")
            if left <= 0:
                raise PeerError("timeout", f"{words} within {self._consumer.timeout_s:g} s")
        if not done():
            raise self._failure(self._lost or "")

    def check(self) -> None:
        """Raise PeerError where the connection is gone."""
        if self._lost is not None:
            raise self._failure(self._lost)

    def close(self, *, with_will: bool = True) -> None:
        """Leave, saying so where that is possible; a broker that hangs is not waited for.

        with_will: whether the broker is to say the will.
        """
        if self._lost is None and self._answer is not None:
            with suppress(OSError, ValueError):
                words = _WITH_WILL if with_will else "Normal disconnection"
                self._client.disconnect(ReasonCode(PacketTypes.DISCONNECT, words))
            with self._changed:
                self._changed.wait_for(lambda: self._lost is not None, LEAVE_S)
        raw = self._client.socket()
        if isinstance(raw, socket.socket):
            with suppress(OSError):
                raw.shutdown(socket.SHUT_RDWR)
        ending = threading.Thread(target=self._client.loop_stop, name="mqtt end", daemon=True)
        ending.start()
        ending.join(LEAVE_S)

    def _failure(self, words: str) -> PeerError:
        said = f" ({self._said})" if self._said else ""
        return PeerError("certificate" if "CERTIFICATE" in self._said.upper() else "lost", f"{words}{said}")

    # --- called in the library's thread ---------------------------------------------------------------------

    def _connected(
        self,
        client: Client,
        _data: Any,
        _flags: ConnectFlags,
        answer: ReasonCode,
        properties: Properties | None,
    ) -> None:
        most = getattr(properties, "ReceiveMaximum", MESSAGES_AT_ONCE)
        client._max_inflight_messages = min(MESSAGES_AT_ONCE, most)  # noqa: SLF001 - known with the answer, no sooner
        with self._changed:
            self._answer = answer
            self._changed.notify_all()

    def _disconnected(
        self,
        _client: Client,
        _data: Any,
        _flags: DisconnectFlags,
        reason: ReasonCode,
        _properties: Properties | None,
    ) -> None:
        with self._changed:
            self._lost = f"the connection ended: {reason}"
            self._changed.notify_all()
        self._place.wake()

    def _published(
        self, _client: Client, _data: Any, number: int, reason: ReasonCode, _properties: Properties | None
    ) -> None:
        with self._changed:
            self._acknowledged[number] = reason
            if self._awaited <= self._acknowledged.keys():
                self._changed.notify_all()

    def _subscribed(
        self,
        _client: Client,
        _data: Any,
        number: int,
        reasons: list[ReasonCode],
        _properties: Properties | None,
    ) -> None:
        # messages and subscriptions share their numbers: what confirms one says nothing of the other
        with self._changed:
            self._confirmed[number] = reasons[0]
            self._changed.notify_all()

    def _arrived(self, _client: Client, _data: Any, message: MQTTMessage) -> None:
        self._on_message(message.topic, bytes(message.payload))
        with self._changed:
            self._changed.notify_all()
        self._place.wake()

    def _logged(self, _client: Client, _data: Any, level: int, words: str) -> None:
        if level in {LogLevel.MQTT_LOG_ERR, LogLevel.MQTT_LOG_WARNING}:
            self._said = self._said or words


class _TlsSocket(ssl.SSLSocket):
    """A socket that is closed where its handshake fails, which the library leaves undone."""

    def do_handshake(self, block: bool = False) -> None:
        try:
            super().do_handshake(block)
        except BaseException:
            self.close()
            raise


def client_id_of(consumer: North, place: Place) -> str:
    """Return the identifier of a connection: as configured, or of host, database and consumer.

    Databases of one file name lie in many folders of a host: a checksum of the path tells them apart.
    """
    path = zlib.crc32(str(place.db.resolve()).encode())
    made = f"deltak-{socket.gethostname()}-{place.db.stem}-{path:08x}-{consumer.name}"
    return consumer.client_id or re.sub(r"[^A-Za-z0-9_.-]", "_", made)


def tls_context(consumer: North, folder: Path) -> ssl.SSLContext:
    """Return what a certificate is looked at by, and the own one. Raises PeerError."""
    try:
        context = ssl.create_default_context(
            cafile=None if consumer.ca is None else str(folder / consumer.ca)
        )
        if consumer.cert is not None and consumer.key is not None:
            refuse_expired(folder / consumer.cert)
            context.load_cert_chain(folder / consumer.cert, folder / consumer.key, password="")
        context.sslsocket_class = _TlsSocket
    except (OSError, ValueError) as error:  # of the latter kind are a UnicodeDecodeError and one of base64
        files = ", ".join(
            str(file) for file in (consumer.ca, consumer.cert, consumer.key) if file is not None
        )
        raise PeerError("certificate", f"{files}: {error}") from error
    return context


def cause_of(error: Exception) -> str:
    """Return the cause of what connecting raised, in a word."""
    if isinstance(error, ssl.SSLError):
        return "certificate"
    return "timeout" if isinstance(error, TimeoutError) else "refused"
