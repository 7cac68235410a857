# SPDX-License-Identifier: Apache-2.0
"""Who may open the page and who may operate: names, certificate, token.

A page of another site in the same browser must neither press nor see anything: every request has to name this server as
its host (an attacker's name that resolves to this address does not), and the live connection has to come from a page of
this server. Whoever reaches it may watch; operating may be left out, or need a token.
"""

from __future__ import annotations

import hmac
import ipaddress
import ssl
import stat
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
SHORTEST_TOKEN = 16
HEADERS: Mapping[str, str] = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data:; form-action 'none'; base-uri 'none'; frame-ancestors 'none'",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
"""Of every answer: nothing is loaded from elsewhere, and no other page may frame this one and have it clicked."""


@dataclass(frozen=True)
class Access:
    """Where the page is served, and to whom.

    Parameters
    ----------
    address
        Of this machine.
    port
        Of the server.
    names
        Host names, without port, under which browsers may reach it.
    operate
        Whether pages may operate.
    token
        That a page has to give for it; empty: none.
    certificate
        For TLS, with its key; None: without.
    """

    address: str
    port: int
    names: tuple[str, ...]
    operate: bool = True
    token: str = field(default="", repr=False)
    certificate: ssl.SSLContext | None = None

    @property
    def scheme(self) -> str:
        """Of the page's address."""
        return "https" if self.certificate else "http"

    @property
    def url(self) -> str:
        """The page's address."""
        return f"{self.scheme}://{self.names[0]}:{self.port}/"

    def refusal(self, host: str, origin: str | None, site: str | None, live: bool) -> str:
        """Why a request is refused; empty: it is not.

        Parameters
        ----------
        host, origin, site
            Its headers Host, Origin and Sec-Fetch-Site; None: it has none.
        live
            Whether it requests the live connection, which only a page of this server may have.
        """
        default = {"http": ":80", "https": ":443"}[self.scheme]
        hosts = {f"{name}:{self.port}" for name in self.names}
        if default == f":{self.port}":
            hosts |= set(self.names)
        if host.lower() not in hosts:
            return f"host {host!r}, expected {' or '.join(sorted(hosts))}"
        own = f"{self.scheme}://{host.lower()}"
        if origin is None and live:
            return f"no origin, expected {own}"
        if origin is not None and origin.lower() != own:
            return f"origin {origin!r}, expected {own}"
        if live and site not in (None, "same-origin"):
            return f"a {site} request, expected one of this server's page"
        return ""

    def may_operate(self, token: str) -> bool:
        """Whether a page that gives this `token` may operate."""
        known = not self.token or hmac.compare_digest(token.encode(), self.token.encode())
        return self.operate and known


def make_access(
    address: str, port: int, hosts: Sequence[str], operate: bool, token_file: str, certificate: str, key: str
) -> Access:
    """Check what was given.

    Parameters
    ----------
    address, port
        Of the server.
    hosts
        Further host names under which browsers reach it.
    operate
        Whether pages may operate.
    token_file
        File with the token; empty: none.
    certificate, key
        Files of PEM, for TLS; empty: none.

    Raises
    ------
    AbraceError
        `parameter <name>: <value>, expected ...`; also for operating beyond loopback without token and TLS.
    """
    try:
        ip = ipaddress.ip_address(address)
    except ValueError as error:
        raise AbraceError(f"parameter address: {address}, expected an IP address of this machine") from error
    if bool(certificate) != bool(key):
        missing, other = ("key", "certificate") if certificate else ("certificate", "key")
        raise AbraceError(f"parameter {missing}: not given, expected a file, because {other} is given")
    if token_file and not operate:
        raise AbraceError(f"parameter token_file: {token_file}, expected none with operate:=false")
    token = read_token(token_file) if token_file else ""
    context = _context(certificate, key) if certificate else None
    if operate and not ip.is_loopback and not (token and context):
        raise AbraceError(
            f"parameter address: {address}, beyond this machine, expected token_file, certificate and key with it, "
            "127.0.0.1, or operate:=false"
        )
    own = f"[{ip}]" if ip.version == 6 else str(ip)
    names = [*([] if ip.is_unspecified else [own]), *map(str.lower, hosts)]
    if not names:
        raise AbraceError(
            f"parameter hosts: not given, expected the names by which browsers reach it, with address {address}"
        )
    if ip.is_loopback or ip.is_unspecified:
        names += [name for name in LOOPBACK if name not in names]
    return Access(address, port, tuple(names), operate, token, context)


def read_token(path: str) -> str:
    """The token in a file that only its owner can read.

    Raises
    ------
    AbraceError
        If there is none, it is too short, or others can read it.
    """
    try:
        text = Path(path).read_text(encoding="utf-8").strip()
        mode = Path(path).stat().st_mode
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not a text"
        raise AbraceError(f"parameter token_file: {path}: {reason}, expected a file with a token") from error
    if stat.S_IMODE(mode) & 0o077:
        raise AbraceError(f"parameter token_file: {path}: others can read it, expected chmod 600 {path}")
    if len(text) < SHORTEST_TOKEN or len(text.split()) != 1:
        raise AbraceError(
            f"parameter token_file: {path}: expected one word of {SHORTEST_TOKEN} characters or more, "
            f"as by: openssl rand -hex 16"
        )
    return text


def _context(certificate: str, key: str) -> ssl.SSLContext:
    for name, path in (("certificate", certificate), ("key", key)):
        if not Path(path).is_file():
            raise AbraceError(f"parameter {name}: {path}: no such file, expected one of PEM")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        # an empty password: OpenSSL would ask for one on the terminal
        context.load_cert_chain(certificate, key, password="")
    except OSError as error:
        raise AbraceError(
            f"parameter certificate: {certificate}: with key {key}: {_reason(error)}, expected a certificate and its "
            "key in PEM, without a password"
        ) from error
    return context


def _reason(error: OSError) -> str:
    if isinstance(error, ssl.SSLError):
        return (error.reason or "not PEM").lower().replace("_", " ")
    return error.strerror or str(error)
