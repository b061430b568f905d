"""The commands of keys, from the line that is typed to the request that is let through."""

import pytest

from api_client import V1, assert_problem, serving
from creak.api import create_app
from creak.api.access import Access
from creak.cli import run
from store_records import fill_beam

RIGS = """
[[rigs]]
rig = "rig.toml"
model = "model.toml"
[rigs.source]
kind = "simulated"
"""


@pytest.fixture
def config(url, tmp_path):
    path = tmp_path / "creak.toml"
    path.write_text(f'[store]\nurl = "{url}"\n{RIGS}')
    return path


@pytest.fixture
def key(config, capsys):
    """Types a command of keys; its exit code, what it printed and what it complained of."""

    def typed(*words):
        code = run(["key", *words, "--config", str(config)])
        said = capsys.readouterr()
        return code, said.out.splitlines(), said.err.splitlines()

    return typed


def with_key(token):
    return {"Authorization": f"Bearer {token}"}


def test_a_key_is_made_listed_used_and_removed(key, store, monkeypatch):
    """Kills a scope that is not held to, a list that shows secrets, and a removed key that still opens."""
    monkeypatch.setattr("creak.api.access._KEY_SECONDS", 0.0)
    fill_beam(store)
    tokens = {}
    for name, scope in (("wall", "read"), ("control room", "operate"), ("chief", "admin")):
        code, (tokens[scope],), err = key("add", name, "--scope", scope)
        assert (code, err) == (0, [])
    assert len(set(tokens.values())) == 3
    code, lines, _ = key("list")
    assert (code, lines) == (0, ["admin   chief", "operate control room", "read    wall"])
    with serving(create_app(store, access=Access(keys=True))) as client:
        allowed = {
            scope: [
                client.get(f"{V1}/rigs", headers=with_key(token)).status_code,
                client.post(
                    f"{V1}/alarms/nosuch/acknowledge", json={"by": "a"}, headers=with_key(token)
                ).status_code,
                client.get(f"{V1}/audit", headers=with_key(token)).status_code,
            ]
            for scope, token in tokens.items()
        }
        assert allowed == {"read": [200, 403, 403], "operate": [200, 404, 403], "admin": [200, 404, 200]}
        assert client.get(f"{V1}/rigs", headers={"X-API-Key": tokens["read"]}).status_code == 200
        assert key("remove", "wall") == (0, [], [])
        assert_problem(client.get(f"{V1}/rigs", headers=with_key(tokens["read"])), 401, "unauthorized")
        assert client.get(f"{V1}/rigs", headers=with_key(tokens["operate"])).status_code == 200
    code, (again,), _ = key("add", "wall")  # the smallest scope unless told otherwise
    assert (code, key("list")[1][-1]) == (0, "read    wall")
    assert again not in tokens.values()


def test_only_a_hash_is_kept(key, store, url, tmp_path):
    _, (token,), _ = key("add", "wall")
    secret = token.split("_", 2)[2]
    with store.read() as connection:
        rows = connection.exec_driver_sql("SELECT * FROM api_keys").all()
    assert len(rows) == 1
    assert secret not in repr(rows)
    if url.startswith("sqlite"):
        files = list((tmp_path / "var").glob("creak.db*"))
        assert files
        assert not any(secret.encode() in file.read_bytes() for file in files)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("add", "wall"), "already"),
        (("add", ""), "1 to 100"),
        (("add", "a\nb"), "printable"),
        (("add", "x" * 101), "1 to 100"),
        (("add", "new", "--scope", "root"), "root"),
        (("remove", "nosuch"), "'nosuch'"),
        (("add",), "NAME"),
        (("burn", "wall"), "burn"),
    ],
)
def test_wrong_input_is_one_line_and_changes_nothing(key, words, says):
    key("add", "wall")
    code, out, err = key(*words)
    assert (code, out, len(err)) == (2, [], 1)
    assert says.lower() in err[0].lower()
    assert key("list")[1] == ["read    wall"]


def test_a_missing_service_file_is_named(tmp_path, capsys):
    assert run(["key", "list", "--config", str(tmp_path / "nosuch.toml")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "nosuch.toml" in line
