"""A server with a certificate and users: encrypted, for trusted clients alone, and found without either."""

import asyncio
import logging
import socket
from collections.abc import Awaitable
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from asyncua.crypto.cert_gen import setup_self_signed_certificate
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from cryptography.x509.oid import ExtendedKeyUsageOID

from agent.cli.glance.files import several
from agent.cli.opcua.access import Options, check
from agent.cli.opcua.server import running
from agent.cli.web.secret import Secret
from tests.web import files

pytestmark = pytest.mark.soak
PASSWORD = "correct horse"
K1 = "ns=2;s=rig/press-7/k1"


async def certificate(folder: Path, name: str) -> tuple[Path, Path]:
    """Make a certificate of an application and its key."""
    cert, key = folder / f"{name}.der", folder / f"{name}.pem"
    usage = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
    names = {"countryName": "CH", "organizationName": name}
    await setup_self_signed_certificate(key, cert, f"urn:{name}", socket.gethostname(), usage, names)
    key.chmod(0o600)
    return cert, key


async def read(address: str, own: tuple[Path, Path] | None, server: Path, user: str | None = "anna") -> Any:
    client = Client(address)
    client.application_uri = "urn:client" if own is None else f"urn:{own[0].stem}"
    if own is not None:
        await client.set_security(SecurityPolicyBasic256Sha256, *own, server_certificate=server)
    if user is not None:
        client.set_user(user)
        client.set_password(PASSWORD)
    async with client:
        return (await client.get_node(K1).read_data_value(raise_on_bad_status=False)).Value.Value


async def forced(address: str) -> None:
    """Read without encryption although no endpoint offers that: what discovery leaves open."""
    client = Client(address)
    await client.connect_socket()
    try:
        await client.send_hello()
        await client.open_secure_channel()
        made = await client.uaclient.create_session(ua.CreateSessionParameters(EndpointUrl=address))
        token = ua.UserNameIdentityToken(PolicyId="username", UserName="anna", Password=PASSWORD.encode())
        assert made.AuthenticationToken
        await client.uaclient.activate_session(ua.ActivateSessionParameters(UserIdentityToken=token))
        await client.get_node(K1).read_value()
    finally:
        client.disconnect_socket()


async def refused(call: Awaitable[Any]) -> str:
    with pytest.raises(ua.UaStatusCodeError) as error:
        await asyncio.wait_for(call, 20.0)
    return str(ua.status_codes.get_name_and_doc(error.value.code)[0])


def test_only_trusted_clients_with_a_user_read_and_all_of_it_is_encrypted(tmp_path: Path) -> None:
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)
    path = files.make(tmp_path, hops=20)

    async def scene() -> None:
        server, ours, theirs = [await certificate(tmp_path, name) for name in ("server", "ours", "theirs")]
        (tmp_path / "trusted").mkdir()
        (tmp_path / "trusted" / "ours.der").write_bytes(ours[0].read_bytes())
        options = Options(
            port=0, certificate=server[0], key=server[1], trusted=tmp_path / "trusted", private=True
        )
        users = {"anna": Secret.of_password(PASSWORD)}
        check(options, users)
        async with running(several([path], []), options, users) as address:
            found = await Client(address).connect_and_get_server_endpoints()
            assert {one.SecurityMode for one in found} == {ua.MessageSecurityMode.SignAndEncrypt}
            assert {token.TokenType for one in found for token in one.UserIdentityTokens} == {
                ua.UserTokenType.UserName
            }
            assert isinstance(await read(address, ours, server[0]), float)
            whys = [
                await refused(read(address, own, server[0], user))
                for own, user in ((ours, None), (ours, "tom"), (theirs, "anna"))
            ]
            assert whys == ["BadIdentityTokenRejected", "BadUserAccessDenied", "BadUserAccessDenied"]
            for user in ("anna", None):
                with pytest.raises(ua.UaError, match="No matching endpoints"):
                    await read(address, None, server[0], user)
            assert await refused(forced(address)) == "BadUserAccessDenied"

    asyncio.run(scene())
