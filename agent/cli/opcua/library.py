"""What asyncua is asked beyond plain use: discovery without a session, and the server's certificate."""

from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.crypto.security_policies import SecurityPolicyFactory, SecurityPolicyNone

from agent.cli.opcua.access import Rules
from agent.errors import UsageError


class DiscoverableServer(Server):  # type: ignore[misc] # the library is not followed by the type checker
    """A server whose endpoints can be asked for unencrypted, where nothing else can be (Part 4, 5.4)."""

    async def _setup_server_nodes(self) -> None:
        await super()._setup_server_nodes()
        if ua.SecurityPolicyType.NoSecurity not in self._security_policy:
            self._policies.append(
                SecurityPolicyFactory(
                    SecurityPolicyNone, ua.MessageSecurityMode.None_, permission_ruleset=Rules(allowed=())
                )
            )


async def load_certificate(server: Any, certificate: Path, key: Path, uri: str) -> None:
    """Give a server its certificate and key (PEM or DER) and its application's URI. Raises UsageError."""
    try:
        await server.load_certificate(certificate)
        await server.load_private_key(key)
        await server.set_application_uri(_uri(server.iserver.certificate) or uri)
    except (OSError, ValueError, TypeError, ua.UaError) as error:
        advice = "name a certificate and its key in PEM or DER"
        raise UsageError.at("--certificate", f"cannot be used ({error})", advice) from error


def _uri(certificate: Any) -> str | None:
    """Return the application's URI that a certificate is made out to; clients compare the two."""
    from cryptography import x509

    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return None
    return next(iter(names.get_values_for_type(x509.UniformResourceIdentifier)), None)
