"""No message goes where it must not go, whatever the URL looks like and whatever a name resolves to."""

import asyncio
import ipaddress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from creak.errors import RefusedAddressError
from creak.webhooks.addresses import REFUSED, AddressPolicy, parse_target, resolve

NAMES = {
    "public.example": ["93.184.215.14"],
    "both.example": ["93.184.215.14", "127.0.0.1"],
    "six.example": ["2606:2800:21f:cb07:6820:80da:af6b:8b2c", "::1"],
    "private.example": ["10.0.0.7"],
    "metadata.example": ["169.254.169.254"],
    "nat64.example": ["64:ff9b::7f00:1"],
    "empty.example": [],
    "scoped.example": ["fe80::1%eth0"],
    "localhost": ["127.0.0.1", "::1"],
    "localhost.": ["127.0.0.1"],
}


async def names(host, port):
    if host not in NAMES:
        raise OSError(-2, "Name or service not known")
    return NAMES[host]


def passes(url, allow=()):
    return asyncio.run(resolve(parse_target(url), AddressPolicy(allow), resolver=names))


HOSTILE = [
    "http://127.0.0.1/",
    "http://127.0.0.1:8300/api/v1/webhooks",
    "http://127.1/",
    "http://127.0.1/",
    "http://2130706433/",
    "http://0x7f000001/",
    "http://0x7f.0.0.1/",
    "http://0177.0.0.1/",
    "http://017700000001/",
    "http://127.0.0.1./",
    "http://127.255.255.254/",
    "http://0.0.0.0/",
    "http://0/",
    "http://localhost/",
    "http://LOCALHOST/",
    "http://localhost./",
    "http://10.0.0.1/",
    "http://172.16.0.1/",
    "http://172.31.255.255/",
    "http://192.168.1.1/",
    "http://100.64.0.1/",
    "http://169.254.169.254/latest/meta-data/",
    "http://168.63.129.16/",
    "http://192.0.0.192/",
    "http://198.18.0.1/",
    "http://203.0.113.9/",
    "http://224.0.0.1/",
    "http://255.255.255.255/",
    "http://240.0.0.1/",
    "http://[::1]/",
    "http://[::]/",
    "http://[0:0:0:0:0:0:0:1]/",
    "http://[::ffff:127.0.0.1]/",
    "http://[::ffff:7f00:1]/",
    "http://[::127.0.0.1]/",
    "http://[::ffff:0:127.0.0.1]/",
    "http://[64:ff9b::127.0.0.1]/",
    "http://[64:ff9b:1::1]/",
    "http://[2002:7f00:1::]/",
    "http://[2001:0:7f00:1::]/",
    "http://[fe80::1]/",
    "http://[fe80::1%25eth0]/",
    "http://[fd00:ec2::254]/",
    "http://[fec0::1]/",
    "http://[ff02::1]/",
    "http://[2001:db8::1]/",
    "http://[4000::1]/",
    "http://[::1",
    "http://[v1.a]/",
    "http://both.example/",
    "http://six.example/",
    "https://private.example/",
    "http://metadata.example/",
    "http://nat64.example/",
    "http://scoped.example/",
    "http://empty.example/",
    "http://unknown.example/",
    "http://public.example@127.0.0.1/",
    "http://user:word@public.example/",
    "http://public.example#@127.0.0.1/",
    "http://public.example\\@127.0.0.1/",
    "http://public.example%2f@127.0.0.1/",
    "http://127.0.0.1%00.public.example/",
    "http://public.example\t/",
    " http://public.example/",
    "http://public.example/\r\nHost: 127.0.0.1",
    "http://①②⑦.0.0.1/",
    "http://127。0。0。1/",
    "http://public.example:0/",
    "http://public.example:/",
    "http://public.example:99999/",
    "http://public.example:80:80/",
    "http:/public.example/",
    "http:public.example",
    "http:///path",
    "http://",
    "//public.example/",
    "public.example",
    "",
    "file:///etc/passwd",
    "gopher://127.0.0.1:6379/_FLUSHALL",
    "ftp://public.example/",
    "javascript:alert(1)",
    "unix:///var/run/docker.sock",
    "http+unix://%2Fvar%2Frun%2Fdocker.sock/",
    "http://-public.example/",
    "http://public..example/",
    "http://public.example/" + "a" * 2000,
]


def test_there_are_enough_hostile_urls():
    assert len(HOSTILE) == len(set(HOSTILE)) >= 40


@pytest.mark.parametrize("url", HOSTILE, ids=lambda url: url[:40] or "empty")
def test_hostile_url_is_refused_in_one_line(url):
    with pytest.raises(RefusedAddressError) as caught:
        passes(url)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("url", "host", "port", "path", "authority"),
    [
        ("https://public.example", "public.example", 443, "/", "public.example"),
        ("http://PUBLIC.example:8080/a?b=c&d", "public.example", 8080, "/a?b=c&d", "public.example:8080"),
        ("https://93.184.215.14:443/x", "93.184.215.14", 443, "/x", "93.184.215.14"),
        ("http://[2606:2800:21f::1]:81/", "2606:2800:21f::1", 81, "/", "[2606:2800:21f::1]:81"),
    ],
)
def test_good_url_is_taken_apart(url, host, port, path, authority):
    target = parse_target(url)
    assert (target.host, target.port, target.path, target.authority) == (host, port, path, authority)
    assert passes(url)


def test_allow_list_opens_its_networks_and_nothing_else():
    assert passes("http://10.20.3.4/", ["10.20.0.0/16"])
    assert passes("http://127.0.0.1:9/", ["127.0.0.0/8"])
    assert passes("http://private.example/", ["10.0.0.0/24"])
    for url in ("http://10.21.0.1/", "http://[::ffff:10.20.3.4]/", "http://both.example/", "http://[::1]/"):
        with pytest.raises(RefusedAddressError, match=r"\[webhooks\] allow"):
            passes(url, ["10.20.0.0/16"])
    with pytest.raises(RefusedAddressError, match="::1 is not a public address"):
        passes("http://localhost/", ["127.0.0.0/8"])  # one good address does not make the others good
    assert passes("http://localhost/", ["127.0.0.0/8", "::1/128"])


@given(st.ip_addresses())
def test_whatever_python_knows_as_not_global_is_refused(address):
    """Kills a network that is missing from the table; hypothesis likes the special-purpose ones."""
    if not address.is_global or address.is_multicast:
        with pytest.raises(RefusedAddressError):
            AddressPolicy().check(address)


@pytest.mark.parametrize("network", [network for network, _ in REFUSED], ids=str)
def test_refused_networks_are_refused_to_their_ends(network):
    for address in (network[0], network[-1]):
        with pytest.raises(RefusedAddressError):
            AddressPolicy().check(address)
        AddressPolicy([str(network)]).check(address)


def test_look_up_that_does_not_end_is_a_refusal():
    async def never(host, port):
        await asyncio.sleep(60)

    with pytest.raises(RefusedAddressError, match="cannot be resolved: no answer in time"):
        asyncio.run(resolve(parse_target("http://a.example/"), AddressPolicy(), resolver=never, seconds=0.01))


def test_neighbours_of_refused_networks_pass():
    """Kills a table that refuses the internet as a whole."""
    for text in ("9.255.255.255", "11.0.0.0", "128.0.0.1", "172.32.0.0", "192.169.0.0", "223.255.255.255"):
        AddressPolicy().check(ipaddress.ip_address(text))
    AddressPolicy().check(ipaddress.ip_address("2a00:1450::1"))
