"""A server that takes signed and encrypted messages alone, of clients that it trusts, on the library asyncua.

    secured.py --folder F [--days -10:-1] [--names IP:127.0.0.1] [--trust FILE ...] [--policy sign]

Its certificate is made anew, with these days from today on and these names, and lies in F/server.der. It prints where it
listens, and has two axes: X at 12.5 and Y at -3."""

import argparse
import asyncio
import datetime
import ipaddress
import pathlib
import socket

from asyncua import Server, ua
from asyncua.crypto.truststore import TrustStore
from asyncua.crypto.validator import CertificateValidator, CertificateValidatorOptions
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

URI = "urn:secured"
POLICIES = {
    "none": ua.SecurityPolicyType.NoSecurity,
    "sign": ua.SecurityPolicyType.Basic256Sha256_Sign,
    "sign-and-encrypt": ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
}


def make(folder, days, names):
    key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "secured")])
    now = datetime.datetime.now(datetime.timezone.utc)
    first, last = (now + datetime.timedelta(days=day) for day in days)
    others = [
        x509.IPAddress(ipaddress.ip_address(value)) if kind == "IP" else x509.DNSName(value)
        for kind, value in (text.split(":", 1) for text in names)
    ]
    builder = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(first)
        .not_valid_after(last)
        .add_extension(x509.SubjectAlternativeName([x509.UniformResourceIdentifier(URI), *others]), False)
        .add_extension(x509.BasicConstraints(False, None), True)
        .add_extension(x509.KeyUsage(True, True, True, True, False, False, False, False, False), True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), False)
    )
    certificate = builder.sign(key, hashes.SHA256())
    encoding = serialization.Encoding
    (folder / "server.der").write_bytes(certificate.public_bytes(encoding.DER))
    (folder / "server.pem").write_bytes(
        key.private_bytes(encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )


async def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--folder", type=pathlib.Path, required=True)
    arguments.add_argument("--days", default="-1:30")
    arguments.add_argument("--names", nargs="*", default=["IP:127.0.0.1"])
    arguments.add_argument("--trust", type=pathlib.Path, nargs="*", default=[])
    arguments.add_argument("--policy", choices=POLICIES, nargs="*", default=["sign-and-encrypt"])
    arguments = arguments.parse_args()
    folder = arguments.folder
    make(folder, [float(day) for day in arguments.days.split(":")], arguments.names)
    clients = folder / "clients"
    clients.mkdir(exist_ok=True)
    for file in clients.iterdir():
        file.unlink()
    # A store may not be empty: nobody has the key of this one but the server itself.
    for number, file in enumerate([folder / "server.der", *arguments.trust]):
        (clients / f"{number}.der").write_bytes(file.read_bytes())
    store = TrustStore([clients], [])
    await store.load()
    server = Server()
    await server.init()
    await server.set_application_uri(URI)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}")
    server.set_security_policy([POLICIES[policy] for policy in arguments.policy])
    await server.load_certificate(str(folder / "server.der"))
    await server.load_private_key(str(folder / "server.pem"))
    kinds = CertificateValidatorOptions
    options = kinds.EXT_VALIDATION | kinds.TRUSTED | kinds.PEER_CLIENT
    server.set_certificate_validator(CertificateValidator(options, store))
    index = await server.register_namespace("SinumerikVarProvider")
    for number, (name, position) in enumerate([("X", 12.5), ("Y", -3.0)], 1):
        for path, value in [("name", name), ("actToolBasePos", position)]:
            node = f"/Channel/MachineAxis/{path}[u1,{number}]"
            await server.nodes.objects.add_variable(ua.NodeId(node, index), f"{path}{number}", value)
    async with server:
        print(f"listening on opc.tcp://127.0.0.1:{port}", flush=True)
        await asyncio.Event().wait()


asyncio.run(main())
