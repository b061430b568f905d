"""Where messages may go: the guard against requests forged through a receiver's URL.

A host is resolved once, every address that it has is checked, and the connection is made to one of these
addresses: between check and connection no name is looked up again. An address passes if it lies in one of the
operator's networks (``[webhooks] allow``), or else in none of :data:`REFUSED`.
"""

import asyncio
import ipaddress
import re
import socket
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from urllib.parse import urlsplit

from creak.errors import RefusedAddressError

Address = ipaddress.IPv4Address | ipaddress.IPv6Address
Network = ipaddress.IPv4Network | ipaddress.IPv6Network
Resolver = Callable[[str, int], Awaitable[list[str]]]

REFUSED: tuple[tuple[Network, str], ...] = tuple(
    (ipaddress.ip_network(network), name)
    for network, name in (
        ("0.0.0.0/8", "this network"),
        ("10.0.0.0/8", "private"),
        ("100.64.0.0/10", "carrier-grade NAT"),
        ("127.0.0.0/8", "loopback"),
        ("169.254.0.0/16", "link-local, where clouds keep their metadata"),
        ("172.16.0.0/12", "private"),
        ("192.0.0.0/24", "protocol assignments"),
        ("192.0.2.0/24", "documentation"),
        ("192.31.196.0/24", "AS112"),
        ("192.52.193.0/24", "AMT"),
        ("192.88.99.0/24", "6to4 relay"),
        ("192.168.0.0/16", "private"),
        ("192.175.48.0/24", "AS112"),
        ("198.18.0.0/15", "benchmarking"),
        ("198.51.100.0/24", "documentation"),
        ("203.0.113.0/24", "documentation"),
        ("168.63.129.16/32", "metadata of a cloud"),
        ("224.0.0.0/4", "multicast"),
        ("240.0.0.0/4", "reserved"),
        ("::/96", "unspecified, loopback and IPv4-compatible"),
        ("::ffff:0:0/96", "IPv4-mapped"),
        ("::ffff:0:0:0/96", "IPv4-translated"),
        ("64:ff9b::/96", "NAT64"),
        ("64:ff9b:1::/48", "local NAT64"),
        ("100::/64", "discard"),
        ("2001::/23", "protocol assignments, Teredo among them"),
        ("2001:db8::/32", "documentation"),
        ("2002::/16", "6to4"),
        ("2620:4f:8000::/48", "AS112"),
        ("3fff::/20", "documentation"),
        ("5f00::/16", "segment routing"),
        ("fc00::/7", "private"),
        ("fe80::/10", "link-local"),
        ("fec0::/10", "site-local"),
        ("ff00::/8", "multicast"),
    )
)
"""Networks of no public host, with their names: the special-purpose registries of IANA, and all of IPv6 that leads
to an IPv4 address."""

_GLOBAL_6 = ipaddress.ip_network("2000::/3")
_LABEL = re.compile(r"[a-z0-9_]([a-z0-9_-]{0,61}[a-z0-9_])?", re.ASCII)
_LONGEST_URL = 2000


@dataclass(frozen=True)
class Target:
    """A receiver's URL, taken apart.

    Parameters
    ----------
    tls : bool
    host : str
        Lower case, without brackets.
    port : int
    path : str
        With the query, as it goes into the request.
    """

    tls: bool
    host: str
    port: int
    path: str

    @property
    def authority(self) -> str:
        """The ``Host`` header."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return host if self.port == (443 if self.tls else 80) else f"{host}:{self.port}"


class AddressPolicy:
    """To which addresses connections are made.

    Parameters
    ----------
    allow : iterable of str
        Networks of the operator's choice, also if they are in `REFUSED`.
    """

    def __init__(self, allow: Iterable[str] = ()) -> None:
        self._allow = tuple(ipaddress.ip_network(network) for network in allow)

    def check(self, address: Address) -> None:
        """Pass an address.

        Raises
        ------
        RefusedAddressError
            If nothing may be sent there.
        """
        scoped = getattr(address, "scope_id", None) is not None
        if not scoped and any(address in network for network in self._allow):
            return
        found = next((name for network, name in REFUSED if address in network), None)
        if found is None and not scoped and (address.version == 4 or address in _GLOBAL_6):
            return
        raise RefusedAddressError(
            f"{address} is not a public address ({found or 'not assigned'}); allowed are public ones and those "
            "in the networks of [webhooks] allow"
        )


def parse_target(url: str) -> Target:
    """Take a receiver's URL apart, strictly: what two parsers could read in two ways is refused.

    Raises
    ------
    RefusedAddressError
        If it is no http or https URL of a host.
    """
    if len(url) > _LONGEST_URL:
        raise RefusedAddressError(f"the URL has {len(url)} characters; allowed are {_LONGEST_URL}")
    if not url.isascii() or any(character <= " " or character in '\\"<>^`{|}\x7f' for character in url):
        raise RefusedAddressError("the URL holds characters that no URL may hold unescaped")
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise RefusedAddressError(f"not a URL: {error}") from None
    if parts.scheme not in {"http", "https"} or not url[len(parts.scheme) :].startswith("://"):
        raise RefusedAddressError("not an http or https URL")
    if "@" in parts.netloc:
        raise RefusedAddressError("a user or password in the URL is not allowed; messages are signed instead")
    if parts.fragment or "#" in url:
        raise RefusedAddressError("a fragment is not allowed in the URL")
    if port == 0 or parts.netloc.endswith(":"):
        raise RefusedAddressError("the port is missing or 0")
    tls = parts.scheme == "https"
    path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    return Target(tls, _host(parts.hostname or "", parts.netloc), port or (443 if tls else 80), path)


def _host(host: str, netloc: str) -> str:
    """Check a host: an address in its one usual form, or a name."""
    if netloc.startswith("["):
        try:
            return str(ipaddress.IPv6Address(host))
        except ValueError:
            raise RefusedAddressError(f"{host!r} is not an IPv6 address") from None
    name = host.removesuffix(".")
    labels = name.split(".")
    if not name or len(name) > 253 or not all(map(_LABEL.fullmatch, labels)):
        raise RefusedAddressError(f"{host!r} is not the name of a host")
    if labels[-1].isdigit() or re.fullmatch(r"0x[0-9a-f]*", labels[-1]):
        try:  # octal, hexadecimal, short and 32-bit forms mean different hosts to different programs
            return str(ipaddress.IPv4Address(name))
        except ValueError:
            raise RefusedAddressError(f"{host!r} is not an IPv4 address of four decimal numbers") from None
    return name


async def system_resolver(host: str, port: int) -> list[str]:
    """Ask the operating system for all addresses of a host."""
    found = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
    return [str(entry[4][0]) for entry in found]


async def resolve(
    target: Target, policy: AddressPolicy, *, resolver: Resolver = system_resolver, seconds: float = 5.0
) -> tuple[Address, ...]:
    """Return the addresses of a target, in the resolver's order; they are those to connect to.

    Raises
    ------
    RefusedAddressError
        If the host is not known, or any of its addresses is one to which nothing may be sent.
    """
    try:
        literal = ipaddress.ip_address(target.host)
    except ValueError:
        try:
            async with asyncio.timeout(seconds):
                found = await resolver(target.host, target.port)
        except (OSError, UnicodeError, TimeoutError) as error:
            reason = getattr(error, "strerror", None) or str(error) or "no answer in time"
            raise RefusedAddressError(f"{target.host!r} cannot be resolved: {reason}") from None
        try:
            addresses = tuple(dict.fromkeys(map(ipaddress.ip_address, found)))
        except ValueError as error:
            raise RefusedAddressError(f"{target.host!r} cannot be resolved: {error}") from None
    else:
        addresses = (literal,)
    if not addresses:
        raise RefusedAddressError(f"{target.host!r} has no address")
    for address in addresses:
        policy.check(address)
    return addresses
